# SPDX-License-Identifier: MIT
"""Commands and their help; what they print, and how they end."""

import errno
import json
import logging
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer
from command_line import called, every_command, invoked, logger_as_before, only_json, parsed, python
from scans import files_below, salsanext_of, write_sequence, write_weights
from shallow_network import SHALLOW

from salsanext_cli import __version__
from salsanext_cli.__main__ import main
from salsanext_cli.commands.line.app import COMMANDS
from salsanext_cli.commands.line.options import removed
from salsanext_cli.commands.line.output import console, help
from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.texts import with_hint
from salsanext_cli.io.weights.card_file import default_weights, read_card

ROOT = Path(__file__).parents[3]
HEAVY = ("torch", "open3d", "numba", "matplotlib", "numpy", "scipy", "pandas", "joblib", "rich")
HEAVY += ("plyfile",)
UNUSED_BY_PREDICT = (
    *("torch", "open3d", "matplotlib", "pandas", "sklearn", "joblib", "plyfile", "rich"),
    "numba.typed.dictimpl",  # the compiler, not what runs compiled kernels
)


def test_help_lists_the_commands_by_section_in_order(run):
    lines = run("--help").stdout.splitlines()
    named = [line for line in lines if line[:1].isupper() or line[2:3] > " "]
    names = [line.split()[0].removesuffix(":") for line in named]
    expected = [word for section, members in COMMANDS.items() for word in (section, *members)]
    assert names[names.index("Start") : names.index("Options")] == expected
    assert lines[:1] == ["Usage: salsanext [OPTIONS] COMMAND"]


def test_help_is_short_and_the_whole_help_lists_every_option(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for name in every_command():
        usual, whole = (run(*name.split(), flag).stdout for flag in ("--help", "--help-all"))
        options = {option for p in parsed(name).params for option in p.opts if option[0] == "-"}
        assert {word.rstrip(",") for word in whole.split()} >= {*options, "--help"}, name
        # The whole help is offered where it shows more, and only there.
        assert ("--help-all" in usual) == (whole != usual), name
        assert "<" not in whole, name
        assert f"{help.DOCUMENTATION}/cli/#salsanext-{name.replace(' ', '-')}" in usual
        lengths = [len(line) for line in usual.splitlines()]
        assert len(lengths) <= 60, name
        assert max(lengths) <= 80, name
    predict = run("predict", "--help").stdout
    assert "--knn-k" not in predict
    assert "--json" in predict
    assert "--aleatoric" in run("uncertainty", "--help").stdout
    assert "--install-completion" not in run("--help").stdout
    assert "--install-completion" in run("--help-all").stdout


def test_hidden_and_common_options_exist_and_removed_ones_do_not():
    offered = {name: {o for p in parsed(name).params for o in p.opts} for name in every_command()}
    every = {"--install-completion", "--show-completion"}.union(*offered.values())
    for command, options in help.HIDDEN.items():
        assert {*options.split()} <= (offered[command] if command else every)
    for command, options in removed.REMOVED_OPTIONS.items():
        commands = [name for name in offered if command in ("", name, *name.split())]
        assert commands
        for option in options:
            assert " " in option or all(option not in offered[name] for name in commands)
    assert not removed.REMOVED_COMMANDS.keys() & offered.keys()
    for name in every_command():
        flags = {flag for parameter in parsed(name).params for flag in parameter.opts}
        assert flags >= {"--json", "-v", "--verbose", "-q", "--quiet"}, name
        assert not any(flag.startswith("--no-") for flag in flags), name


def test_the_addresses_of_the_project_are_those_of_its_metadata():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["urls"]["Documentation"] == help.DOCUMENTATION


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
def test_memory_that_runs_out_is_an_error(monkeypatch, raised):
    def fail(*_args, **_options):
        try:
            raise raised
        except Exception:
            raise SystemError("error return without exception set")  # noqa: B904

    monkeypatch.setattr("salsanext_cli.__main__.handle_signals", lambda: None)
    monkeypatch.setattr("salsanext_cli.commands.line.app.main", fail)
    with pytest.raises(SystemExit, match=r"^error: memory ran out: "):
        main()
    monkeypatch.setattr("salsanext_cli.commands.line.app.main", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main()


def test_no_command_gives_help_and_the_version_is_a_line(run):
    for words, section in (((), "Start:"), (("tune",), "Commands:")):
        result = run(*words)
        assert section in result.stderr
        assert result.exit_code == 2
    result = run("-V")
    assert (result.exit_code, result.stdout) == (0, f"salsanext {__version__}\n")
    assert run("--verbose").exit_code == 2


def test_the_verbose_version_names_packages_device_and_instructions(run):
    result = run("--version", "--verbose")
    lines = dict(line.split(" ", 1) for line in result.stdout.splitlines())
    assert lines["salsanext"] == __version__
    assert lines["numpy"] == np.__version__
    assert lines["device:"] in ("cpu", "cuda")
    assert {"torch", "openvino", "instructions:", "extras:"} <= {*lines}


def test_help_imports_nothing_heavy():
    done = python(
        "import sys\n"
        "sys.argv = ['salsanext', 'predict', '--help']\n"
        "from salsanext_cli.commands.line.app import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code\n"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_a_second_predict_imports_no_library_that_it_does_not_compute_with(tmp_path):
    """A run in this process fills the caches; the second runs without the compilers.

    Its network has two levels, which this process alone knows: nothing but the graph is read.
    """
    write_sequence(tmp_path / "data", ["0"])
    first, second = tmp_path / "first", tmp_path / "second"
    weights = tmp_path / "shallow.safetensors"
    options = ["-q", "--error", "--device", "cpu", "--weights", f"{weights}"]
    with salsanext_of(**SHALLOW):
        write_weights(weights, error=read_card(default_weights()).error)
        called("predict", tmp_path / "data", first, *options)
    words = ["salsanext", "predict", f"{tmp_path / 'data'}", f"{second}", *options]
    ended = python(
        "import sys\n"
        "from salsanext_cli.commands.line.app import main\n"
        f"sys.argv = {words!r}\n"
        "try:\n    main()\n"
        "except SystemExit as leaving:\n    assert not leaving.code\n"
        f"print([name for name in {UNUSED_BY_PREDICT!r} if name in sys.modules])\n"
    )
    assert (ended.returncode, ended.stdout) == (0, "[]\n"), ended.stderr
    assert files_below(first / "sequences") == files_below(second / "sequences")


def test_characters_outside_the_encoding_of_stdout_are_replaced():
    code = "from salsanext_cli.commands.line import app\n"
    code += "app.app = lambda: print('1 \\xb1 2'); app.main()"
    ended = python(code, LC_ALL="C", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0")
    assert (ended.returncode, ended.stdout) == (0, "1 ? 2\n"), ended.stderr


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("predikt", ["predikt"]),
        ("predict --overwrit", ["salsanext predict", "--overwrit"]),
        ("knn-refine a b", ["salsanext knn-refine", "b"]),
        ("predict --engine onnx", ["--engine", "onnx", "openvino"]),
        ("tune temperature only-one", ["salsanext tune temperature", "WEIGHTS_OUT"]),
        ("tune dropout data w.safetensors --samples few", ["--samples", "few"]),
    ],
)
def test_a_wrong_command_line_is_status_two_and_one_object_of_json(run, line, words):
    result = run(*line.split(), "--json")
    error = only_json(result)
    assert (result.exit_code, error["schema"], error["code"]) == (2, 2, "usage")
    for word in words:
        assert word in error["error"]
    assert error["hint"].endswith(("--help", "--overwrite?"))
    assert result.stderr == f"error: {error['error']}\nhint: {error['hint']}\n"
    result = run(*line.split())
    assert (result.exit_code, result.stdout) == (2, "")


def invoke(body, *arguments):
    """Run a command of one line."""
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command()
    @console.guarded
    def command(json: bool = False, verbose: bool = False, quiet: bool = False) -> None:
        body(console.Output(json, verbose, quiet))

    return invoked(app, *arguments)


def raising(error):
    def body(_):
        raise error

    return body


def test_an_error_has_a_line_for_its_hint_and_a_status_and_a_bug_its_traceback():
    for error, flags, status, stdout, stderr in (
        (
            *(FormatError("a.bin", "17 bytes", "a multiple of 16", "copy it again"), [], 1, ""),
            "error: a.bin: 17 bytes (expected a multiple of 16)\nhint: copy it again\n",
        ),
        (
            *(FormatError("a.bin", "17 bytes"), ["--json"], 1),
            *(
                '{"schema": 2, "error": "a.bin: 17 bytes", "hint": "", "code": "format"}\n',
                "error: a.bin: 17 bytes\n",
            ),
        ),
        (UsageError("--limit", "0"), [], 2, "", "error: --limit: 0\n"),
        (
            *(KeyboardInterrupt(), ["--json"], 130),
            '{"schema": 2, "error": "interrupted", "hint": "", "code": "interrupted"}\n',
            "interrupted: no file is incomplete\n",
        ),
    ):
        result = invoke(raising(error), *flags)
        assert (result.exit_code, result.stdout, result.stderr) == (status, stdout, stderr)
    result = invoke(raising(ZeroDivisionError("of ours")))
    assert isinstance(result.exception, ZeroDivisionError)
    assert result.exit_code not in (0, 2, 130)
    assert "error:" not in result.stderr


def test_verbose_and_quiet_choose_the_messages():
    for flag, expected in (
        ([], ["warning: three", "error: four", "printed"]),
        (["--quiet"], ["error: four"]),
        (["--verbose"], ["two", "warning: three", "error: four", "printed"]),
    ):

        def body(output):
            log = logging.getLogger("salsanext_cli.somewhere")
            log.info("two")
            log.warning("%s", "three")
            log.error("four")
            output.print("printed")

        result = invoke(body, *flag)
        assert result.stderr.splitlines() == expected
        assert invoke(body, "--verbose", "--quiet").exit_code == 2


def test_a_result_is_a_table_or_json():
    def body(output):
        output.result({"name": "Größe \udcff", "value": 1.5}, "a table")

    assert invoke(body).stdout == "a table\n"
    result = json.loads(invoke(body, "--json").stdout)
    assert 0 <= result.pop("seconds") < 10
    assert result == {"schema": 2, "name": "Größe \\xff", "value": 1.5}


def test_a_warning_has_a_line_for_its_hint_and_no_other(capsys):
    text = with_hint("two\nlines.bin: no intensity", "see the\nmanual")
    with logger_as_before():
        console.log_to_stderr()
        logging.getLogger("salsanext_cli.x").warning("%s", text)
    expected = "warning: two\\x0alines.bin: no intensity\nhint: see the\\x0amanual\n"
    assert capsys.readouterr().err == expected
