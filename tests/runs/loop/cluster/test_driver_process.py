# SPDX-License-Identifier: MIT
"""The process of a driver: it ends with the run, whatever it waits for, and its silence too."""

import signal
import time
from queue import SimpleQueue

import pytest
from time_limits import TimeLimitError, time_limit

from salsanext_cli.runs.loop.cluster import driver_process
from salsanext_cli.runs.loop.cluster.messages import FreePlaces

ECHO = """
import pickle, sys
while True:
    try:
        message = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    pickle.dump(message, sys.stdout.buffer)
    sys.stdout.buffer.flush()
"""
DEAF = "import time; time.sleep(100)"


@pytest.fixture
def started(monkeypatch):
    """Return a function that starts a driver with a program, and short waits."""
    monkeypatch.setattr(driver_process, "END_NOTICE_AFTER_S", 0.05)
    monkeypatch.setattr(driver_process, "DRIVER_END_TIMEOUT_S", 0.1)
    monkeypatch.setattr(driver_process, "POLL_INTERVAL_S", 0.01)

    def start(program):
        monkeypatch.setattr(driver_process, "PROGRAM", program)
        return driver_process.driver_process()

    return start


def test_messages_go_there_and_back_until_the_driver_ends(started, monkeypatch):
    monkeypatch.setattr(driver_process, "END_NOTICE_AFTER_S", 30.0)
    large = b"0" * 200_000  # More than a pipe holds
    with started(ECHO) as driver:
        messages = driver.messages()
        for message in (FreePlaces(count=3), large, large):
            driver.send(message)
        assert [next(messages) for _ in range(3)] == [FreePlaces(count=3), large, large]
    assert driver.process.returncode == 0


def test_a_driver_that_is_silent_or_reads_nothing_is_killed(started, monkeypatch, caplog):
    monkeypatch.setattr(driver_process, "MAX_SILENT_POLLS", 3)
    with time_limit(20.0), started(DEAF) as driver:
        driver.send(b"0" * 1_000_000)
        assert [*driver.messages()] == []
        assert driver.ending() == "does not answer within 0 s"
    assert driver.process.returncode == -9
    caplog.set_level("INFO")
    with time_limit(20.0), started(DEAF) as driver:
        pass
    assert driver.process.returncode == -9
    assert "are being ended" in caplog.text


def test_an_interruption_of_its_end_kills_a_driver(started, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), started(DEAF) as driver:
        monkeypatch.setattr(driver, "_has_ended", interrupt)
    assert driver.process.returncode == -9


def test_a_test_that_waits_for_too_long_fails():
    start = time.monotonic()
    with pytest.raises(TimeLimitError), time_limit(0.02):
        SimpleQueue().get()
    assert time.monotonic() - start < 10
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
