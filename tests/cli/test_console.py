# SPDX-License-Identifier: MIT
import json
import logging
import os
import signal
import time

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
