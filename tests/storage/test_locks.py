# SPDX-License-Identifier: MIT
import errno
import logging
from pathlib import Path

import pytest

from salsanext_cli.errors import OutputError
from salsanext_cli.storage import locks
from salsanext_cli.storage.locks import Held, locked


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / ".lock"


def test_one_at_a_time(path: Path) -> None:
    with locked(path), pytest.raises(Held, match="held by another process"), locked(path):
        pass
    with locked(path):
        pass


def test_those_who_share_hold_it_together(path: Path) -> None:
    with locked(path, shared=True), locked(path, shared=True):
        with pytest.raises(Held), locked(path):
            pass
        assert path.exists()
    with locked(path), pytest.raises(Held), locked(path, shared=True):
        pass


def test_its_file_goes_with_the_last(path: Path) -> None:
    with locked(path, shared=True):
        with locked(path, shared=True):
            pass
        assert path.exists()
    assert not path.exists()


def test_a_file_that_was_left_means_nothing(path: Path) -> None:
    path.parent.mkdir()
    path.touch()
    with locked(path):
        pass
    assert not path.exists()


def test_a_lock_whose_file_was_removed_is_not_taken_for_the_lock(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between opening the file and locking it, whoever held it may have removed it."""
    original, opened = locks._open, []

    def removed_at_first(path: Path) -> int:
        handle = original(path)
        if not opened:
            path.unlink()
        opened.append(handle)
        return handle

    monkeypatch.setattr(locks, "_open", removed_at_first)
    with locked(path):
        assert len(opened) == 2
        with pytest.raises(Held), locked(path):
            pass


def test_the_folder_may_go_while_it_is_held(path: Path) -> None:
    with locked(path):
        path.unlink()
        path.parent.rmdir()


def test_where_no_file_can_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"), locked(tmp_path / "file" / "lock"):
        pass


def without_locks(monkeypatch: pytest.MonkeyPatch, number: int | None) -> None:
    locks._say_unlocked.cache_clear()
    if number is None:
        monkeypatch.setattr(locks, "fcntl", None)
        return

    def refuse(*_: object) -> None:
        raise OSError(number, "no locks available")

    monkeypatch.setattr(locks.fcntl, "flock", refuse)


@pytest.mark.parametrize("number", [None, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_without_locks_it_goes_on_and_says_so_once(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    """On Windows, and on some network disks."""
    without_locks(monkeypatch, number)
    ran = 0
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            with locked(path):
                ran += 1
    assert ran == 2
    assert [record.message.partition(" (")[0] for record in caplog.records] == [
        "output folders are not locked"
    ]
