# SPDX-License-Identifier: MIT
import re
import typing

import pytest
from command_line import every_command, parsed, python

from salsanext_cli import __version__
from salsanext_cli.cli import options
from salsanext_cli.cli.app import COMMANDS

NAMES = list(every_command())
PIPELINE = ["project", "train", "predict", "knn-refine", "uncertainty", "eval", "export-ply"]
HEAVY = ("torch", "open3d", "numba", "matplotlib", "numpy", "scipy", "pandas", "joblib", "plyfile")


def test_help_lists_the_commands_by_panel_in_order(run):
    result = run("--help")
    assert result.exit_code == 0
    words = re.findall(r"^(?:╭─|│) (\S+)", result.stdout, re.MULTILINE)
    known = {name for commands in COMMANDS.values() for name in commands} | COMMANDS.keys()
    listed = [word for word in words if word in known]
    assert listed == [w for panel, names in COMMANDS.items() for w in (panel, *names)]


def test_the_panels_are_those_of_the_design():
    order = ["Pipeline", "Data", "Models", "Look"]
    assert [panel for panel in order if panel in COMMANDS] == list(COMMANDS)
    assert list(COMMANDS["Pipeline"]) == PIPELINE
    assert set(COMMANDS["Data"]) >= {"synth", "inspect"}
    assert list(COMMANDS["Models"])[:3] == ["models", "import-weights", "tune"]
    assert "demo" in COMMANDS["Look"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_every_help_ends_its_text_with_an_example(run, name, flag):
    result = run(*name.split(), flag)
    assert result.exit_code == 0
    text = " ".join(result.stdout.partition("╭─")[0].split())
    assert re.search(rf"\. Example: salsanext {name}( \S+)*$", text), text


def test_no_command_gives_help(run):
    result = run()
    assert "Pipeline" in result.output
    assert result.exit_code == 2
    result = run("tune")
    names = ["temperature", "dropout", "batchnorm"]
    assert re.findall(rf"│ ({'|'.join(names)}) ", result.output) == names
    assert result.exit_code == 2


def test_version(run):
    result = run("--version")
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


@pytest.mark.parametrize(
    "arguments",
    [
        ["predikt"],
        ["predict", "--overwrit"],
        ["predict", "a", "b", "c"],
        ["predict", "--limit", "many"],
        ["predict", "--on-error", "panic"],
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


def test_a_typo_is_not_taken_for_something_else(run):
    result = run("predict", "--overwrit")
    assert "No such option" in result.stderr
    assert "--overwrite" in result.stderr


def declared_options():
    """Return the options and arguments that `options` declares, by name."""
    return {
        name: value
        for name, value in vars(options).items()
        if typing.get_origin(value) is typing.Annotated
    }


def hints_of(command):
    return typing.get_type_hints(command, include_extras=True)


def test_every_shared_option_is_used():
    used = [hint for command in every_command().values() for hint in hints_of(command).values()]
    unused = [name for name, option in declared_options().items() if option not in used]
    assert len(declared_options()) > 10
    assert unused == []


@pytest.mark.parametrize("name", NAMES)
def test_every_command_talks_as_json_and_can_be_silent(name):
    flags = {flag for parameter in parsed(name).params for flag in parameter.opts}
    assert flags >= {"--json", "-v", "--verbose", "-q", "--quiet"}
    assert not any(flag.startswith("--no-") for flag in flags)


@pytest.mark.parametrize("name", NAMES)
def test_every_option_has_help(name):
    assert [
        p.name for p in parsed(name).params if not getattr(p, "help", None) and p.name != "help"
    ] == []


def test_the_stages_of_the_pipeline_take_the_common_options():
    common = {"--split", "--sequences", "--limit", "--jobs", "--on-error", "--json", "-v", "-q"}
    for name in set(PIPELINE) - {"train"}:
        command = parsed(name)
        flags = {flag for parameter in command.params for flag in parameter.opts}
        assert flags >= common, name
        if name != "eval":
            assert flags >= {"--overwrite", "--sensor"}, name
    for name in ("predict", "uncertainty", "export-ply"):
        command = parsed(name)
        flags = {flag for parameter in command.params for flag in parameter.opts}
        assert flags >= {"--weights", "--device"}, name


def test_colour_is_spelt_both_ways():
    command = parsed("export-ply")
    (colour,) = [p for p in command.params if p.name == "colour"]
    assert colour.opts == ["--colour", "--color"]
