# SPDX-License-Identifier: MIT
import json
import logging
import os
import signal
import time

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


def test_an_error_is_one_line_and_a_status():
    for error, flags, status, stdout, stderr in (
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
        (
            *(KeyboardInterrupt(), ["--json"], 130),
            '{"schema": 1, "error": "interrupted", "code": "interrupted"}\n',
            "interrupted: everything finished so far is intact\n",
        ),
    ):
        result = invoke(raising(error), *flags)
        assert (result.exit_code, result.stdout, result.stderr) == (status, stdout, stderr)


def test_sigterm_is_status_143_and_unwinds(tmp_path):
    lock = tmp_path / "lock"
    # Not that of a library which another test has used.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def body(output):
        lock.touch()
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)
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


def test_how_much_is_said():
    for flag, expected in (
        ([], ["warning: three", "error: four", "said"]),
        (["--quiet"], ["error: four"]),
        (["--verbose"], ["two", "warning: three", "error: four", "said"]),
    ):

        def body(output):
            log = logging.getLogger("salsanext_cli.somewhere")
            log.info("two")
            log.warning("%s", "three")
            log.error("four")
            output.say("said")

        result = invoke(body, *flag)
        assert result.stderr.splitlines() == expected
        assert invoke(body, "--verbose", "--quiet").exit_code == 2


def test_a_result_is_shown_or_json():
    def body(output):
        output.result({"name": "Größe \udcff", "value": 1.5}, "a table")

    assert invoke(body).stdout == "a table\n"
    found = json.loads(invoke(body, "--json").stdout)
    assert 0 <= found.pop("seconds") < 10
    assert found == {"schema": 1, "name": "Größe \\xff", "value": 1.5}


def test_a_log_file_gets_a_line_now_and_then(monkeypatch, capsys):
    """A training that goes on counts its own steps only."""
    now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    lines = console.Lines("predict", "scans")
    for done in range(901, 1001):
        now += 3.0
        lines(done, 1000)
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "predict: 910/1000 scans, 3.0 s/scan, 4 min left"
    assert len(err) == 9
    assert not any("1000/1000" in said for said in err)
