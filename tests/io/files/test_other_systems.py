# SPDX-License-Identifier: MIT
"""What Windows refuses: opening folders, removing open files, blocking signals."""

import os
import signal
from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.locks import locked
from salsanext_cli.runs.loop.blocked_signals import signals_blocked


def refuse(*_: object, **__: object) -> None:
    raise PermissionError(13, "the file is in use by another process")


def test_a_durable_file_needs_no_open_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "open", refuse)
    write_bytes(tmp_path / "a", b"whole", durable=True)
    assert (tmp_path / "a").read_bytes() == b"whole"


def test_a_file_that_another_program_has_open_stays_and_is_one_error(tmp_path, monkeypatch):
    write_bytes(tmp_path / "a", b"old")
    monkeypatch.setattr(Path, "replace", refuse)
    caught = refused(OutputError, tmp_path / "a", write_bytes, tmp_path / "a", b"new")
    assert "in use" in caught.value.problem
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_a_lock_file_that_cannot_be_removed_is_free_again(tmp_path, monkeypatch):
    lock = tmp_path / ".predict.lock"
    with monkeypatch.context() as open_files:
        open_files.setattr(Path, "unlink", refuse)
        with locked(lock), pytest.raises(OutputError), locked(lock):
            pass
    assert lock.exists()
    with locked(lock):
        pass


def test_workers_start_without_blocked_signals(monkeypatch):
    monkeypatch.delattr(signal, "pthread_sigmask")
    with signals_blocked(signal.SIGINT):
        started = True
    assert started
