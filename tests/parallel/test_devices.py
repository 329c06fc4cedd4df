# SPDX-License-Identifier: MIT
"""No GPU is needed: how many there are is said."""

import os
import signal
import subprocess
import sys
import threading
from contextvars import copy_context

import pytest

from salsanext_cli.parallel import devices as gpus
from salsanext_cli.parallel.devices import ONE_EACH, Slot, own_device

pytest.importorskip("fcntl")


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    """Keep the locks of this test to itself."""
    monkeypatch.setattr(gpus, "_folder_of_locks", lambda: tmp_path / "locks")
    monkeypatch.setattr(gpus, "_HELD", gpus._Held())


def in_worker(device, count):
    def ask():
        ONE_EACH.set(True)
        return own_device(device, count)

    return copy_context().run(ask)


def test_slots_are_numbered_from_zero_and_used_again(tmp_path):
    slots = [Slot(tmp_path) for _ in range(3)]
    assert [slot.number for slot in slots] == [0, 1, 2]
    del slots[1]
    assert Slot(tmp_path).number == 1


HOLD = """
import sys
from pathlib import Path
from salsanext_cli.parallel.devices import Slot
slot = Slot(Path(sys.argv[1]))
sys.stdout.write(f"{slot.number}\\n")
sys.stdout.flush()
sys.stdin.read()
"""


def test_a_killed_process_leaves_its_slot_to_the_next(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "0\n"
        assert Slot(tmp_path).number == 1
        os.kill(other.pid, signal.SIGKILL)
        other.wait()
        assert Slot(tmp_path).number == 0


@pytest.mark.parametrize("device", ["auto", "cuda"])
def test_workers_take_a_gpu_each_and_keep_it(device):
    found = []

    def worker():
        ONE_EACH.set(True)
        found.append([own_device(device, 2) for _ in range(2)])
        meeting.wait(10)

    meeting = threading.Barrier(5)
    threads = [threading.Thread(target=worker) for _ in range(4)]
    for thread in threads:
        thread.start()
    meeting.wait(10)
    for thread in threads:
        thread.join()
    assert sorted(found) == [["cuda:0"] * 2] * 2 + [["cuda:1"] * 2] * 2


@pytest.mark.parametrize(("device", "count"), [("cpu", 4), ("cuda:3", 4), ("auto", 1), ("cuda", 0)])
def test_what_was_named_or_is_alone_stays(device, count):
    assert in_worker(device, count) == device


def test_who_is_no_worker_takes_the_first():
    assert own_device("auto", 4) == "auto"
