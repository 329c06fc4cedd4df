# SPDX-License-Identifier: MIT
import errno
import logging
import os
import subprocess
import sys
from pathlib import Path

import filelock
import pytest

from salsanext_cli.errors import OutputError, warn_once
from salsanext_cli.files.locks import locked

HOLD = "import sys; from pathlib import Path; from salsanext_cli.files.locks import locked\n"
HOLD += "with locked(Path(sys.argv[1])): print('held', flush=True); sys.stdin.readline()"


def test_one_process_at_a_time_and_the_file_goes_with_it(tmp_path: Path) -> None:
    path = tmp_path / "new/.lock"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(OutputError, match=r"\.lock · held by another process"), locked(path):
        pass
    holder.kill()
    holder.communicate()
    assert path.exists()  # of a killed process; it means nothing
    with locked(path):
        assert path.exists()
    assert not path.exists()


def test_a_thread_of_this_process_waits_too(tmp_path: Path) -> None:
    with (
        locked(tmp_path / "lock"),
        pytest.raises(OutputError, match="held"),
        locked(tmp_path / "lock", 0.1),
    ):
        pass


def test_the_folder_may_go_while_it_is_held(tmp_path: Path) -> None:
    with locked(tmp_path / "gone/lock"):
        (tmp_path / "gone/lock").unlink()
        (tmp_path / "gone").rmdir()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_without_locks_it_goes_on_and_says_so_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
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
    assert record.message.startswith("output folders are not locked (")
