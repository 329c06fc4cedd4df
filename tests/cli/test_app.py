# SPDX-License-Identifier: MIT
"""Commands and their help."""

import re

import pytest
from command_line import every_command, only_json, parsed, python

from salsanext_cli import __version__
from salsanext_cli.cli.app import COMMANDS

NAMES = list(every_command())
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


def flags_of(name):
    return {flag for parameter in parsed(name).params for flag in parameter.opts}


def test_help_lists_the_commands_by_section_in_order(run):
    result = run("--help")
    assert result.exit_code == 0
    heading_or_name = re.compile(r"^(?:  )?([\w-]+(?: \w+)*)(?::| {2})", re.MULTILINE)
    listed = heading_or_name.findall(result.stdout.partition("\n\n")[2])
    expected = [w for section, names in COMMANDS.items() for w in (section, *names)]
    assert listed[listed.index("Pipeline") :] == expected


def test_no_command_gives_help(run):
    result = run()
    assert "Pipeline" in result.stderr
    assert result.exit_code == 2
    result = run("tune")
    names = ["temperature", "dropout", "batchnorm"]
    assert re.findall(rf"│ ({'|'.join(names)}) ", result.output) == names
    assert result.exit_code == 2


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_version(run, option):
    result = run(option)
    assert result.stdout == f"salsanext {__version__}\n"
    assert result.exit_code == 0


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["predict", "--help"], ["tune", "dropout", "-h"]]
)
def test_help_imports_nothing_heavy(arguments):
    done = python(
        "import sys\n"
        f"sys.argv = ['salsanext', *{arguments!r}]\n"
        "from salsanext_cli.cli.app import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code\n"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_the_list_of_commands_needs_no_rich():
    hidden = "import sys; sys.modules['rich'] = None"
    done = python(f"{hidden}; from salsanext_cli.cli.app import app; app(['--help'])")
    assert "Pipeline:" in done.stdout, done.stderr


def test_what_the_encoding_of_stdout_lacks_is_replaced():
    code = "from salsanext_cli.cli import app; app.app = lambda: print('1 ± 2'); app.main()"
    ended = python(code, PYTHONIOENCODING="ascii")
    assert (ended.returncode, ended.stdout) == (0, "1 ? 2\n"), ended.stderr


def test_python_runs_the_package_as_the_command():
    ended = python(
        "import runpy, sys; sys.argv[1:] = ['--version']; "
        "runpy.run_module('salsanext_cli', run_name='__main__')"
    )
    assert ended.stdout.startswith("salsanext ")
    assert ended.returncode == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ["predikt"],
        ["predict", "--overwrit"],
        ["predict", "a", "b", "c"],
        ["predict", "--limit", "many"],
        ["predict", "--on-error", "panic"],
        ["predict", "--backend", "spark"],
        ["eval", "--json=yes"],
        ["export-ply", "--scale", "1"],
        ["import-weights", "only-one"],
        ["tune", "temprature"],
        ["tune", "temperature", "only-one"],
        ["tune", "dropout", "data", "w.safetensors", "--steps", "few"],
        ["--verbos"],
    ],
)
def test_a_wrong_command_line_is_status_two(run, arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    if "--overwrit" in arguments:
        assert "No such option" in result.stderr
        assert "--overwrite" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["predict", "--overwrit"], "No such option: --overwrit"),
        (["predict", "--limit", "many"], "Invalid value for '--limit'"),
        (["predikt"], "No such command 'predikt'"),
        (["tune", "temprature"], "No such command 'temprature'"),
        (["import-weights"], "Missing argument"),
        (["--verbos"], "No such option: --verbos"),
    ],
)
def test_a_wrong_command_line_is_one_object_of_json(run, arguments, says):
    result = run(*arguments, "--json")
    found = only_json(result)
    assert (result.exit_code, found["schema"], found["code"]) == (2, 1, "usage")
    assert found["error"].startswith(says)
    assert says in result.stderr


@pytest.mark.parametrize("name", NAMES)
def test_every_command_prints_json_and_can_be_silent(name):
    assert flags_of(name) >= {"--json", "-v", "--verbose", "-q", "--quiet"}
    assert not any(flag.startswith("--no-") for flag in flags_of(name))
