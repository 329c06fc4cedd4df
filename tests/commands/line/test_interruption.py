# SPDX-License-Identifier: MIT
"""Signals during a command: one line and the exit status for the first, an end at the next."""

import os
import signal
import subprocess
import sys

import pytest
from command_line import python

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
LINES = {
    signal.SIGINT: "interrupted: no file is incomplete\n",
    signal.SIGTERM: "terminated: no file is incomplete\n",
}
COMMAND = """
import os, signal, sys, time, typer
from salsanext_cli.commands.line.console import guarded
from salsanext_cli.commands.line.interruption import handle_signals
from salsanext_cli.core.errors import MissingDependency
signal.signal(signal.SIGINT, signal.default_int_handler)
handle_signals()
def send(number, process=None):
    os.kill(process or os.getpid(), number)
    time.sleep(10)
def command():
    BODY
app = typer.Typer()
app.command()(guarded(command))
app([])
"""
IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "salsanext_cli.commands.line.own_data":
            os.kill(os.getpid(), NUMBER)
sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, signal.default_int_handler)
from salsanext_cli.__main__ import main
sys.argv.append("models")
main()
"""


def interrupted(body: str, number: signal.Signals) -> None:
    """Require that a command with this body ends with one line and the exit status of a signal."""
    ended = python(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


@SIGNALS
def test_a_signal_during_a_command_or_while_commands_are_imported(number):
    interrupted(f"send({number:d})", number)
    ended = python(IMPORT.replace("NUMBER", f"{number:d}"))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


@SIGNALS
def test_a_signal_while_a_library_makes_a_class(number, tmp_path):
    """Classes are made by `exec`, after whose interruption ``python -m`` would end with SIGINT."""
    body = f'exec("send({number:d})", globals())'
    (tmp_path / "trial.py").write_text(COMMAND.replace("BODY", body))
    paths = os.pathsep.join((str(tmp_path), *sys.path))
    ended = subprocess.run(
        [sys.executable, "-m", "trial"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", LINES[number], 128 + number)


def test_a_signal_that_a_library_ignores_or_turns_into_another_error_counts():
    body = "\n    try: send(2)\n    except KeyboardInterrupt: raise MissingDependency('a', 'b')"
    interrupted(body, signal.SIGINT)
    interrupted("\n    try: send(2)\n    except KeyboardInterrupt: pass", signal.SIGINT)


def test_the_same_signal_twice_lets_the_command_tidy_up(tmp_path):
    """As `timeout` sends it."""
    tidy = f"os.kill(os.getpid(), 15); open({str(tmp_path / 'tidy')!r}, 'w').close()"
    interrupted(f"\n    try: send(15)\n    finally: {tidy}", signal.SIGTERM)
    assert (tmp_path / "tidy").exists()


def test_a_second_signal_ends_the_process_at_once():
    body = "\n    try: send(2)\n    finally: time.sleep(1.2); send(15)"
    ended = python(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("", "", 143)


def test_a_signal_ends_a_forked_process_at_once():
    # A signal that comes before the child has begun is lost.
    body = """
    if not (child := os.fork()):
        while True: time.sleep(1)
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        os.kill(child, 15)
        time.sleep(0.05)
    print(os.waitstatus_to_exitcode(ended[1]))
"""
    ended = python(COMMAND.replace("BODY", body))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("143\n", "", 0)


def test_an_ignored_signal_stays_ignored():
    """As that of a shell that starts a command in the background."""
    ignoring = COMMAND.replace("signal.default_int_handler", "signal.SIG_IGN")
    ended = python(ignoring.replace("BODY", "os.kill(os.getpid(), 2); print('done')"))
    assert (ended.stdout, ended.stderr, ended.returncode) == ("done\n", "", 0)


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("writing('predict', True)", "no scan is finished in this run"),
        ("writing('predict', False)", "3 of 8 scans are processed; no file is incomplete"),
        ("writing('synth', True, 'sequences')", "3 of 8 sequences are processed; no file is in"),
        ("writing('eval', True, at_end=True)", "nothing is finished; no file is incomplete"),
    ],
)
def test_the_line_states_what_is_finished(body, line):
    steps = "" if "no scan" in line else "bar(3, 8);"
    work = f"""
    from salsanext_cli.commands.line.progress import writing
    with {body} as bar: {steps} send(2)"""
    ended = python(COMMAND.replace("BODY", work))
    assert ended.stderr.startswith(f"interrupted: {line}")
    assert ended.returncode == 130


def test_what_was_finished_before_is_not_stated_again():
    work = """
    from salsanext_cli.commands.line.progress import writing
    with writing('predict', True) as bar: bar(3, 8)
    send(2)"""
    interrupted(work, signal.SIGINT)


@SIGNALS
def test_a_signal_that_python_drops_ends_a_training_at_its_next_step(number):
    """Python ignores errors in callbacks of weak references."""
    body = f"""
    import weakref
    from salsanext_cli.commands.line.interruption import require_uninterrupted
    class Thing: pass
    thing = Thing()
    reference = weakref.ref(thing, lambda _: os.kill(os.getpid(), {number:d}))
    del thing
    require_uninterrupted()
    time.sleep(10)
    """
    ended = python(COMMAND.replace("    BODY", body))
    assert ended.stderr.endswith(LINES[number])
    assert ended.returncode == 128 + number
