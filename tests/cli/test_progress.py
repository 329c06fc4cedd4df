# SPDX-License-Identifier: MIT
import os
import pty
import re
import subprocess
import sys
from contextlib import suppress

import pytest

from salsanext_cli.cli import progress as module
from salsanext_cli.cli.progress import Lines


def test_what_is_said_goes_above_the_bar():
    """A pseudo-terminal sees what a user sees; the lines must not be mixed with the bar."""
    screen = on_a_terminal(
        """
import logging
from salsanext_cli.cli import console
from salsanext_cli.cli.progress import progress

output = console.Output(verbose=True)
with progress("predict", quiet=False) as advance:
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
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    lines = Lines("predict", "scans")
    for done in range(first, total + 1):
        now += 3.0
        lines(done, total)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == line
    assert len(err) == 9
    assert not any(f"{total}/{total}" in said for said in err)
