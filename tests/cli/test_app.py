# SPDX-License-Identifier: MIT
"""Commands and their help; what they print, and how they end."""

import errno
import json
import logging
import os
import re

import pytest
import typer
from command_line import every_command, only_json, parsed, python
from scans import files_below, write_sequence
from typer.testing import CliRunner

from salsanext_cli import __version__
from salsanext_cli.__main__ import main
from salsanext_cli.cli import console
from salsanext_cli.cli.app import COMMANDS
from salsanext_cli.errors import FormatError, UsageError

HEAVY = (
    "torch",
    "open3d",
    "numba",
    "matplotlib",
    "numpy",
    "scipy",
    "pandas",
    "joblib",
    "plyfile",
)

UNUSED_BY_PREDICT = (
    *("torch", "open3d", "matplotlib", "pandas", "sklearn", "joblib", "plyfile", "rich"),
    "numba.typed.dictimpl",  # the compiler, not what runs compiled kernels
)


def test_help_lists_the_commands_by_section_in_order(run):
    result = run("--help")
    assert result.exit_code == 0
    heading_or_name = re.compile(r"^(?:  )?([\w-]+(?: \w+)*)(?::| {2})", re.MULTILINE)
    listed = heading_or_name.findall(result.stdout.partition("\n\n")[2])
    expected = [w for section, names in COMMANDS.items() for w in (section, *names)]
    assert listed[listed.index("Pipeline") :] == expected


@pytest.mark.parametrize(
    "raised",
    [
        MemoryError(),
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM), "a.so"),
        ImportError("libtorch_cpu.so: failed to map segment from shared object"),
        RuntimeError(
            "[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried 9 bytes"
        ),
        RuntimeError("Exception from plugin.cpp:74:\nstd::bad_alloc"),
        RuntimeError("can't start new thread"),
    ],
)
def test_memory_that_runs_out_is_one_line(monkeypatch, raised):
    def fail(*_args, **_options):
        try:
            raise raised
        except Exception:
            raise SystemError("error return without exception set")  # noqa: B904

    monkeypatch.setattr("salsanext_cli.__main__.handle_signals", lambda: None)
    monkeypatch.setattr("salsanext_cli.cli.app.main", fail)
    with pytest.raises(SystemExit, match=r"^error: memory ran out: "):
        main()
    monkeypatch.setattr("salsanext_cli.cli.app.main", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main()


def test_no_command_gives_help_and_the_version_is_a_line(run):
    result = run()
    assert "Pipeline" in result.stderr
    assert result.exit_code == 2
    result = run("tune")
    names = ["temperature", "dropout"]
    assert re.findall(rf"│ ({'|'.join(names)}) ", result.output) == names
    assert result.exit_code == 2
    result = run("-V")
    assert result.stdout == f"salsanext {__version__}\n"
    assert result.exit_code == 0


def test_help_imports_nothing_heavy():
    done = python(
        "import sys\n"
        "sys.argv = ['salsanext', 'predict', '--help']\n"
        "from salsanext_cli.cli.app import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code\n"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_a_second_predict_imports_no_library_that_it_does_not_compute_with(tmp_path):
    """The first run makes what is cached; what follows is loaded without what compiled it."""
    write_sequence(tmp_path / "data", ["0"])
    outs = [tmp_path / "first", tmp_path / "second"]
    for out in outs:
        words = ["predict", str(tmp_path / "data"), str(out), "-q", "--error", "--device", "cpu"]
        ended = python(
            "import sys\n"
            "from salsanext_cli.cli.app import main\n"
            f"sys.argv = ['salsanext', *{words!r}]\n"
            "try:\n    main()\n"
            "except SystemExit as leaving:\n    assert not leaving.code\n"
            f"print([name for name in {UNUSED_BY_PREDICT!r} if name in sys.modules])\n"
        )
        assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "[]\n"
    first, second = (files_below(out / "sequences") for out in outs)
    assert first == second


def test_what_the_encoding_of_stdout_lacks_is_replaced():
    code = "from salsanext_cli.cli import app; app.app = lambda: print('1 \\xb1 2'); app.main()"
    ended = python(code, LC_ALL="C", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0")
    assert (ended.returncode, ended.stdout) == (0, "1 ? 2\n"), ended.stderr


def test_a_wrong_command_line_is_status_two_and_one_object_of_json(run):
    for arguments, says in (
        ("predikt", "No such command 'predikt'"),
        ("predict --overwrit", "No such option: --overwrit"),
        ("knn-refine a b", "Got unexpected extra argument"),
        ("predict --backend spark", "Invalid value for '--backend'"),
        ("tune temperature only-one", "Missing argument"),
        ("tune dropout data w.safetensors --steps few", "Invalid value for '--steps'"),
    ):
        result = run(*arguments.split())
        assert (result.exit_code, result.stdout) == (2, "")
        assert "Traceback" not in result.stderr
        result = run(*arguments.split(), "--json")
        found = only_json(result)
        assert (result.exit_code, found["schema"], found["code"]) == (2, 1, "usage")
        assert found["error"].startswith(says)
        assert says in result.stderr


def test_every_command_prints_json_and_can_be_silent():
    for name in every_command():
        flags = {flag for parameter in parsed(name).params for flag in parameter.opts}
        assert flags >= {"--json", "-v", "--verbose", "-q", "--quiet"}, name
        assert not any(flag.startswith("--no-") for flag in flags), name


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
            "error: a.bin: 17 bytes (expected a multiple of 16)\nhint: copy it again\n",
        ),
        (
            *(FormatError("a.bin", "17 bytes"), ["--json"], 1),
            *(
                '{"schema": 2, "error": "a.bin \\u00b7 17 bytes", "code": "format"}\n',
                "error: a.bin: 17 bytes\n",
            ),
        ),
        (UsageError("--limit", "0"), [], 2, "", "error: --limit: 0\n"),
        (
            *(KeyboardInterrupt(), ["--json"], 130),
            '{"schema": 2, "error": "interrupted", "code": "interrupted"}\n',
            "interrupted: everything finished so far is intact\n",
        ),
    ):
        result = invoke(raising(error), *flags)
        assert (result.exit_code, result.stdout, result.stderr) == (status, stdout, stderr)


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
    assert found == {"schema": 2, "name": "Größe \\xff", "value": 1.5}


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
