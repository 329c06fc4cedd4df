# SPDX-License-Identifier: MIT
"""Temporary folders go with the process that made them."""

import errno
import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import filelock
import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.io.files.locks import LOCK, PREFIX, STALE_AFTER_S, locked, temporary_folder

KILLED = """
import os, sys
from pathlib import Path
from salsanext_cli.io.files.locks import temporary_folder
with temporary_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("x")
    os.kill(os.getpid(), 9)
"""


def test_a_folder_is_gone_after_the_body_and_those_that_others_made_or_hold_stay(tmp_path):
    (tmp_path / "mine").mkdir()
    with temporary_folder(tmp_path) as first:
        (first / "file").write_text("x")
        with temporary_folder(tmp_path) as second:
            assert first != second
        assert (first / "file").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    mine = tmp_path / f"{PREFIX}mine"
    mine.mkdir()
    os.utime(mine, (0, 0))
    with temporary_folder(tmp_path) as held:
        os.utime(held / LOCK, (0, 0))
        with temporary_folder(tmp_path):
            assert mine.exists()
            assert held.exists()


def test_the_folder_of_a_killed_process_goes_with_the_next_one(tmp_path):
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    assert subprocess.run(words, check=False).returncode == -9
    (half,) = tmp_path.glob(".*/half")
    with temporary_folder(tmp_path):
        assert half.exists()  # Its process may be about to lock it.
    long_ago = time.time() - 2 * STALE_AFTER_S
    os.utime(half.with_name(LOCK), (long_ago, long_ago))
    with temporary_folder(tmp_path) as folder:
        assert [*tmp_path.iterdir()] == [folder]
    assert not [*tmp_path.iterdir()]


HOLD = "import sys; from pathlib import Path; from salsanext_cli.io.files.locks import locked\n"
HOLD += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.readline()"


def test_one_process_at_a_time_and_the_file_goes_with_it(tmp_path: Path) -> None:
    path = tmp_path / "new/.lock"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(path)], **pipes)
    assert holder.stdout
    assert holder.stdout.readline() == b"held\n"
    with refused(OutputError, path), locked(path):
        pass
    holder.kill()
    holder.communicate()
    assert path.exists()  # of a killed process; it means nothing
    with locked(path):
        assert path.exists()
    assert not path.exists()


def test_a_thread_of_this_process_waits_too_and_the_folder_may_go_meanwhile(tmp_path):
    with (
        locked(tmp_path / "lock"),
        pytest.raises(OutputError, match="lock"),
        locked(tmp_path / "lock", 0.1),
    ):
        pass
    with locked(tmp_path / "gone/lock"):
        (tmp_path / "gone/lock").unlink()
        (tmp_path / "gone").rmdir()


def test_a_folder_that_another_process_removes_before_it_is_locked_is_created_again(
    tmp_path, monkeypatch
):
    """As `remove_if_empty` of a run that ends without results."""
    lock = tmp_path / "new/lock"
    acquire = filelock.FileLock._acquire
    removals = []

    def remove_and_acquire(self):
        if len(removals) < 1:
            removals.append(lock.parent)
            lock.parent.rmdir()
        acquire(self)

    monkeypatch.setattr(filelock.FileLock, "_acquire", remove_and_acquire)
    with locked(lock):
        assert lock.exists()
    assert removals == [lock.parent]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_without_locks_there_is_one_warning(tmp_path, monkeypatch, caplog, number):
    """As on some network disks."""

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(filelock.FileLock, "_acquire", refuse)
    warn_once.cache_clear()
    ran = 0
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            with locked(tmp_path / "lock"):
                ran += 1
    assert ran == 2
    (record,) = caplog.records
    assert os.strerror(number).lower() in record.message
