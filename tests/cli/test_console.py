# SPDX-License-Identifier: MIT
import json
import logging
import os
import pty
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest
import typer
from typer.testing import CliRunner

from salsanext_cli.cli import console
from salsanext_cli.errors import FormatError, UsageError


def invoke(body, *arguments):
    """Run a command of one line."""
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command()
    @console.guarded
    def command(json: bool = False, verbose: bool = False, quiet: bool = False) -> None:
        body(console.Output(json, verbose, quiet))

    return CliRunner().invoke(app, list(arguments))


def raising(error):
    def body(_):
        raise error

    return body


@pytest.mark.parametrize(
    ("error", "flags", "status", "stdout", "stderr"),
    [
        (
            *(FormatError("a.bin", "17 bytes", "a multiple of 16", "copy it again"), [], 1, ""),
            "error: a.bin · 17 bytes · expected a multiple of 16 · copy it again\n",
        ),
        (
            *(FormatError("a.bin", "17 bytes"), ["--json"], 1),
            *(
                '{"schema": 1, "error": "a.bin \\u00b7 17 bytes", "code": "format"}\n',
                "error: a.bin · 17 bytes\n",
            ),
        ),
        (UsageError("--limit", "0"), [], 2, "", "error: --limit · 0\n"),
        (KeyboardInterrupt(), [], 130, "", "interrupted: everything finished so far is intact\n"),
        (
            *(KeyboardInterrupt(), ["--json"], 130),
            '{"schema": 1, "error": "interrupted", "code": "interrupted"}\n',
            "interrupted: everything finished so far is intact\n",
        ),
    ],
)
def test_an_error_is_one_line_and_a_status(error, flags, status, stdout, stderr):
    result = invoke(raising(error), *flags)
    assert (result.exit_code, result.stdout, result.stderr) == (status, stdout, stderr)


def sigterm(_):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(10)


def test_sigterm_is_status_143_and_unwinds(tmp_path):
    lock = tmp_path / "lock"
    # Not that of a library which another test has used.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def body(output):
        lock.touch()
        try:
            sigterm(output)
        finally:
            lock.unlink()

    result = invoke(body)
    assert result.exit_code == 143
    assert result.stderr == "terminated: everything finished so far is intact\n"
    assert not lock.exists()
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_a_program_that_handles_sigterm_goes_on_doing_so():
    seen = []
    before = signal.signal(signal.SIGTERM, lambda *_: seen.append(1))
    try:
        result = invoke(lambda _: os.kill(os.getpid(), signal.SIGTERM))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert (result.exit_code, seen) == (0, [1])


def test_a_bug_keeps_its_traceback():
    result = invoke(raising(ZeroDivisionError("of ours")))
    assert isinstance(result.exception, ZeroDivisionError)
    assert result.exit_code not in (0, 2, 130)
    assert "error:" not in result.stderr


def test_verbose_and_quiet_exclude_each_other():
    result = invoke(lambda output: None, "--verbose", "--quiet")
    assert result.exit_code == 2
    assert "--verbose and --quiet" in result.stderr


@pytest.mark.parametrize(
    ("flag", "expected"),
    [
        ([], ["warning: three", "error: four", "said"]),
        (["--quiet"], ["error: four"]),
        (["--verbose"], ["two", "warning: three", "error: four", "said"]),
    ],
)
def test_how_much_is_said(flag, expected):
    def body(output):
        log = logging.getLogger("salsanext_cli.somewhere")
        log.info("two")
        log.warning("%s", "three")
        log.error("four")
        output.say("said")

    result = invoke(body, *flag)
    assert result.stderr.splitlines() == expected
    assert result.stdout == ""


def test_a_result_is_shown_or_json():
    def body(output):
        output.result({"name": "Größe \udcff", "value": 1.5}, "a table")

    assert invoke(body).stdout == "a table\n"
    found = json.loads(invoke(body, "--json").stdout)
    assert 0 <= found.pop("seconds") < 10
    assert found == {"schema": 1, "name": "Größe \\xff", "value": 1.5}


def test_what_is_said_goes_above_the_bar():
    """A pseudo-terminal sees what a user sees; the lines must not be mixed with the bar."""
    screen = on_a_terminal(
        """
import logging
from salsanext_cli.cli import console

output = console.Output(verbose=True)
with console.progress("predict", quiet=False) as advance:
    advance(1, 4)
    logging.getLogger("salsanext_cli.x").info("08/000001: [red]done[/red]")
    logging.getLogger("salsanext_cli.x").warning("somewhere · %s", "long " * 40)
    output.say("epoch 1")
    advance(2, 4)
"""
    )
    lines = screen.splitlines()
    assert lines[0] == "08/000001: [red]done[/red]"
    assert lines[1].startswith("warning: somewhere · long long")
    assert lines[-2] == "epoch 1"
    assert lines[-1].startswith("predict ")
    assert "2/4" in lines[-1]
    assert "scan" in lines[-1]


def on_a_terminal(code: str) -> str:
    """Run Python on a pseudo-terminal of 100 columns and return what stays on its screen."""
    screen_side, program_side = pty.openpty()
    program = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        stderr=program_side,
    )
    os.close(program_side)
    sent = b""
    # Linux reports the end of a terminal as an error.
    with os.fdopen(screen_side, "rb", buffering=0) as output, suppress(OSError):
        while part := output.read(65536):
            sent += part
    assert program.wait(timeout=60) == 0
    screen = ""
    for piece in re.split(r"(\x1b\[[0-9;?]*[a-zA-Z]|\r|\n)", sent.decode()):
        if piece == "\x1b[2K":
            screen = screen[: screen.rfind("\n") + 1]
        elif piece == "\n" or not re.match(r"\x1b|\r", piece):
            screen += piece
    return screen


@pytest.mark.parametrize(
    ("first", "total", "line"),
    [
        (1, 100, "predict: 10/100 scans, 3.0 s/scan, 4 min left"),
        # A training that goes on counts its own steps only.
        (901, 1000, "predict: 910/1000 scans, 3.0 s/scan, 4 min left"),
    ],
)
def test_a_log_file_gets_a_line_now_and_then(monkeypatch, capsys, first, total, line):
    now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    lines = console.Lines("predict", "scans")
    for done in range(first, total + 1):
        now += 3.0
        lines(done, total)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == line
    assert len(err) == 9
    assert not any(f"{total}/{total}" in said for said in err)
