# SPDX-License-Identifier: MIT
"""Files appear complete or not at all, and one process at a time uses a folder."""

import errno
import logging
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock
import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError, warn_once
from salsanext_cli.io.files.atomic import append_line, write_bytes, writing
from salsanext_cli.io.files.locks import locked


def test_file_appears_whole_and_parents_are_made(tmp_path: Path) -> None:
    path = tmp_path / "a b" / "Größe.bin"
    with writing(path) as file:
        file.write(b"half")
        (half,) = path.parent.iterdir()
        assert half.name.startswith(".")
        assert half.suffix == ".part"
        file.write(b" whole")
    assert path.read_bytes() == b"half whole"
    assert list(path.parent.iterdir()) == [path]


def test_permissions_are_the_usual_ones_and_long_names_have_room(tmp_path):
    (tmp_path / "usual").write_bytes(b"")
    write_bytes(tmp_path / "ours", b"")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode
    path = tmp_path / ("n" * 249 + ".label")
    write_bytes(path, b"label")
    assert path.read_bytes() == b"label"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, ValueError, MemoryError])
def test_interruption_leaves_the_old_file_and_nothing_else(tmp_path, interruption):
    path = tmp_path / "x"
    path.write_bytes(b"old")

    def write() -> None:
        with writing(path) as file:
            file.write(b"new")
            raise interruption

    with pytest.raises(interruption):
        write()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_file_in_place_of_a_folder_and_folder_in_place_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "x", tmp_path / "file" / "deeper" / "x"):
        with pytest.raises(OutputError, match="cannot be written") as caught:
            write_bytes(path, b"x")
        assert caught.value.subject == str(path)
    (tmp_path / "x").mkdir()
    with pytest.raises(OutputError, match="is a directory"):
        write_bytes(tmp_path / "x", b"x")
    assert {entry.name for entry in tmp_path.iterdir()} == {"file", "x"}


def test_read_only_file_system() -> None:
    # /proc refuses even the superuser.
    if not Path("/proc/self").is_dir():
        pytest.skip("needs /proc")
    with pytest.raises(OutputError) as caught:
        write_bytes(Path("/proc/self/salsanext/x"), b"x")
    assert "permissions" in caught.value.hint


@contextmanager
def full_disk(largest: int) -> Iterator[None]:
    """Refuse files above so many bytes, as a full disk would.

    Not a fixture: pytest writes its own progress, maybe into a larger file, while one is active.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, old)


def test_a_file_or_line_that_does_not_fit_on_the_disk_is_an_error(tmp_path):
    with pytest.raises(OutputError, match="free some space") as caught, full_disk(1000):
        write_bytes(tmp_path / "x", b"x" * 5000)
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []
    append_line(tmp_path / "x", b"1" * 600)
    with pytest.raises(OutputError), full_disk(1000):
        append_line(tmp_path / "x", b"2" * 600)


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
