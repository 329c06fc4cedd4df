# SPDX-License-Identifier: MIT
"""The end of a driver whose main process has ended, which no wait of its main thread can delay."""

import sys
from queue import SimpleQueue
from types import SimpleNamespace

import pytest

from salsanext_cli.runs.loop import cluster
from salsanext_cli.runs.loop.cluster import driver_program
from salsanext_cli.runs.loop.cluster.messages import PackedChunk

CHUNK = PackedChunk(number=1, scans=b"scans")


class EndError(BaseException):
    """End of the process."""


@pytest.fixture
def slept(monkeypatch):
    """Return the seconds that were slept; the process ends with an exception."""

    def end(status):
        raise EndError(status)

    seconds = []
    monkeypatch.setattr(driver_program.os, "_exit", end)
    monkeypatch.setattr(driver_program.time, "sleep", seconds.append)
    return seconds


def test_a_main_process_that_has_ended_ends_the_workers(monkeypatch):
    """A message that nobody reads is no loss of the cluster."""

    class Driven:
        begin = staticmethod(lambda: True)
        ended = 0

        def __init__(self, *_):
            pass

        def run(self):
            raise BrokenPipeError

        def end(self):
            Driven.ended += 1

    ray = SimpleNamespace(join=print, JOIN_ERRORS=(), CONNECTION_ERRORS=(ConnectionError,))
    monkeypatch.setitem(sys.modules, f"{cluster.__name__}.ray_cluster", ray)
    monkeypatch.setattr(cluster, "ray_cluster", ray, raising=False)
    monkeypatch.setattr(driver_program, "read", lambda *_: None)
    monkeypatch.setattr(driver_program, "Driver", Driven)
    sent = []
    driver_program.drive(iter([SimpleNamespace(address="auto")]), sent.append)
    assert (sent, Driven.ended) == ([], 1)


@pytest.mark.parametrize("has_begun", [False, True])
def test_a_driver_ends_after_its_last_message_at_once_or_when_its_workers_had_time(
    slept, has_begun
):
    taken = []
    driver = SimpleNamespace(take=taken.append, close=lambda: taken.append("end"))
    driver.has_begun = has_begun
    calls = SimpleQueue()
    with pytest.raises(EndError):
        driver_program.read(iter([CHUNK]), driver, calls)
    while not calls.empty():
        calls.get()()
    assert taken == ([CHUNK, "end"] if has_begun else [CHUNK])
    assert slept == ([driver_program.MAIN_THREAD_TIMEOUT_S] if has_begun else [])
