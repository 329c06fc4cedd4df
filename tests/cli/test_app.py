# SPDX-License-Identifier: MIT
"""Commands and their help."""

import re

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
