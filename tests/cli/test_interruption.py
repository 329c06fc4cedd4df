# SPDX-License-Identifier: MIT
"""Signals in the work of a command, at the moments at which an exception is lost or does harm."""

import importlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import python

from salsanext_cli.cli.interruption import ARRIVED, interruptible
from salsanext_cli.errors import MissingDependency
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.locks import locked
from salsanext_cli.files.optional_packages import import_open3d

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


@pytest.fixture(autouse=True)
def _pythons_own_handlers() -> None:
    # Not those of a library which another test has used.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def interrupted(body: Callable[[], object], number: signal.Signals) -> None:
    """Require that a body ends by a signal, and that the handlers are Python's own again."""
    with pytest.raises(KeyboardInterrupt), interruptible():
        body()
    assert [number] == ARRIVED
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@SIGNALS
def test_an_import_ends_before_the_work_does(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "interrupted_library.py").write_text(
        "import os, time\n"
        f"os.kill(os.getpid(), {number:d})\n"
        "try:\n    time.sleep(0.1)\n"
        "except KeyboardInterrupt as error:\n    raise ImportError from error\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def body() -> None:
        importlib.import_module("interrupted_library")
        time.sleep(10)

    interrupted(body, number)
    assert "interrupted_library" in sys.modules
    del sys.modules["interrupted_library"]


@SIGNALS
@pytest.mark.parametrize("step", ["lock", "open", "os.remove"])
def test_locks_and_unfinished_files_are_removed_at_any_step(
    number: signal.Signals, step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The signal comes when a lock was taken, a file opened, or before the lock goes."""

    def before(call: Callable[..., object], *, after: bool = False) -> Callable[..., object]:
        def called(*args: object, **more: object) -> object:
            if not after:
                os.kill(os.getpid(), number)
            found = call(*args, **more)
            if after:
                os.kill(os.getpid(), number)
            return found

        return called

    if step == "lock":
        from filelock import FileLock

        monkeypatch.setattr(FileLock, "acquire", before(FileLock.acquire, after=True))
    elif step == "open":
        monkeypatch.setattr(Path, "open", before(Path.open, after=True))
    else:
        monkeypatch.setattr(Path, "unlink", before(Path.unlink))

    def body() -> None:
        with locked(tmp_path / ".lock"):
            write_bytes(tmp_path / "whole", b"0")
            if step == "lock":
                time.sleep(10)
        time.sleep(10)

    interrupted(body, number)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_same_signal_twice_does_not_interrupt_tidying_up(tmp_path: Path) -> None:
    def body() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            (tmp_path / "tidy").touch()

    interrupted(body, signal.SIGTERM)
    assert (tmp_path / "tidy").exists()


COMMAND = """
import os, signal, sys, time, typer
from salsanext_cli.cli.console import guarded
from salsanext_cli.cli.interruption import end_on_signals
end_on_signals()
class Figure:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
def command():
    BODY
app = typer.Typer()
app.command()(guarded(command))
app([])
"""


def test_a_signal_in_a_destructor_is_not_lost_and_leaves_no_noise() -> None:
    ended = python(COMMAND.replace("BODY", "Figure(); time.sleep(10)"))
    assert ended.stderr == "interrupted: everything finished so far is intact\n"
    assert ended.returncode == 130


def test_a_signal_that_comes_again_later_ends_at_once() -> None:
    later = "os.kill(os.getpid(), signal.SIGTERM); time.sleep(10)"
    body = f"\n    try: {later}\n    finally: time.sleep(1.2); {later}"
    ended = python(COMMAND.replace("BODY", body))
    assert ended.returncode == 143
    assert "Traceback" not in ended.stderr


def test_a_library_that_an_endless_import_has_broken_is_not_called_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("salsanext_cli.cli.interruption.WAIT_S", 0.1)
    (tmp_path / "open3d.py").write_text(
        "import os, time\n"
        f"os.kill(os.getpid(), {signal.SIGINT:d})\n"
        "try:\n    time.sleep(10)\n"
        "except KeyboardInterrupt as error:\n    raise ImportError('initialization') from error\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)

    def body() -> None:
        with pytest.raises(MissingDependency):
            import_open3d()

    interrupted(body, signal.SIGINT)
