# SPDX-License-Identifier: MIT
"""Commands and their help."""

import re

import pytest
from command_line import every_command, only_json, parsed, python
from scans import files_below, write_sequence

from salsanext_cli import __version__
from salsanext_cli.cli.app import COMMANDS

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


def test_no_command_gives_help(run):
    result = run()
    assert "Pipeline" in result.stderr
    assert result.exit_code == 2
    result = run("tune")
    names = ["temperature", "dropout"]
    assert re.findall(rf"│ ({'|'.join(names)}) ", result.output) == names
    assert result.exit_code == 2


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_version(run, option):
    result = run(option)
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
    lines = [["predict", str(tmp_path / "data"), str(tmp_path / str(i)), "-q"] for i in range(3)]
    code = (
        "import sys\n"
        "from salsanext_cli.cli.app import main\n"
        "for line in {lines!r}:\n"
        "    sys.argv = ['salsanext', *line, '--device', 'cpu']\n"
        "    try:\n        main()\n"
        "    except SystemExit as leaving:\n        assert not leaving.code\n"
        "print([name for name in {unused!r} if name in sys.modules])\n"
    )
    first = python(code.format(lines=[[*lines[0], "--error"]], unused=UNUSED_BY_PREDICT))
    assert first.returncode == 0, first.stderr
    again = python(code.format(lines=[lines[1], [*lines[2], "--error"]], unused=UNUSED_BY_PREDICT))
    assert (again.returncode, again.stdout) == (0, "[]\n"), again.stdout + again.stderr
    results = [files_below(tmp_path / str(i) / "sequences") for i in range(3)]
    assert results[0] == results[2]
    assert results[1].items() < results[2].items()


def test_the_list_of_commands_needs_no_rich():
    hidden = "import sys; sys.modules['rich'] = None"
    done = python(f"{hidden}; from salsanext_cli.cli.app import app; app(['--help'])")
    assert "Pipeline:" in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("environment", "printed"),
    [
        ({"PYTHONIOENCODING": "ascii:backslashreplace"}, "1 \\xb1 2\n"),
        ({"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}, "1 ? 2\n"),
    ],
)
def test_what_the_encoding_of_stdout_lacks_is_replaced_unless_the_user_says_else(
    environment, printed
):
    code = "from salsanext_cli.cli import app; app.app = lambda: print('1 \\xb1 2'); app.main()"
    ended = python(code, **environment)
    assert (ended.returncode, ended.stdout) == (0, printed), ended.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("predikt", "No such command 'predikt'"),
        ("predict --overwrit", "No such option: --overwrit"),
        ("knn-refine a b", "Got unexpected extra argument"),
        ("predict --limit many", "Invalid value for '--limit'"),
        ("predict --on-error panic", "Invalid value for '--on-error'"),
        ("predict --backend spark", "Invalid value for '--backend'"),
        ("export-ply --scale 1", "Invalid value for '--scale'"),
        ("import-weights only-one", "Missing argument"),
        ("tune temprature", "No such command 'temprature'"),
        ("tune temperature only-one", "Missing argument"),
        ("tune dropout data w.safetensors --steps few", "Invalid value for '--steps'"),
        ("--verbos", "No such option: --verbos"),
    ],
)
def test_a_wrong_command_line_is_status_two_and_one_object_of_json(run, arguments, says):
    result = run(*arguments.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert "Traceback" not in result.stderr
    if "--overwrit" in arguments:
        assert "--overwrite" in result.stderr
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
