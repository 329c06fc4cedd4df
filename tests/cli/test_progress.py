# SPDX-License-Identifier: MIT
import io
import sys

import pytest
from rich.console import Console

from salsanext_cli.cli import progress as module
from salsanext_cli.cli.progress import Lines, progress, words_of_rate


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("rate", "words"), [(12.34, "12.3 scans/s"), (1, "1.0 scans/s"), (0.25, "4.0 s/scan")]
)
def test_rates_read_well(rate, words):
    assert words_of_rate(rate, "scans") == words


def test_quiet_shows_nothing():
    with progress("predict", quiet=True) as advance:
        assert advance is None


def test_a_terminal_gets_a_bar_with_rate_and_time_left(monkeypatch):
    stderr = Terminal()
    monkeypatch.setattr(sys, "stderr", stderr)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with progress("predict", quiet=False) as advance:
        for done in range(1, 4):
            advance(done, 4)
    shown = stderr.getvalue()
    assert "predict" in shown
    assert "3/4" in shown
    assert Console(file=stderr).is_terminal


def test_a_log_file_gets_a_line_now_and_then(monkeypatch, capsys):
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    lines = Lines("predict", "scans")
    for done in range(1, 101):
        now += 3.0
        lines(done, 100)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "predict: 10/100 scans, 3.0 s/scan, 4 min left"
    assert len(err) == 9
    assert not any("100/100" in line for line in err)


def test_short_runs_say_nothing_in_a_log_file(capsys):
    with progress("predict", quiet=False) as advance:
        advance(1, 2)
    assert capsys.readouterr() == ("", "")
