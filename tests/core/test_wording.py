# SPDX-License-Identifier: MIT
"""Messages name arguments in Python, and options on the command line, in workers too."""

import ast
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import called, every_command, only_json, parsed, subject
from package_trees import MODULES, PACKAGE, nodes_of, tree_of
from scans import refused, write_sequence
from worker_tasks import name_argument, scans_of

from salsanext_cli.commands.line.options.option_groups import OPTIONS
from salsanext_cli.commands.line.options.option_names import OPTION_OF_EXTRA, RECIPE, CommandLine
from salsanext_cli.commands.stages.inspect import inspect
from salsanext_cli.core import wording
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.training.recipe import Recipe

SPELLERS = ("argument", "setting", "share", "part")


@pytest.fixture
def on_command_line() -> Iterator[None]:
    with wording.spelled(CommandLine()):
        yield


def test_python_reads_arguments():
    assert wording.argument("min_range") == "min_range"
    assert wording.argument("split", "sequences") == "split and sequences"
    assert wording.argument("knn.k") == "k"
    assert wording.setting("device", "cpu") == 'device="cpu"'
    assert wording.setting("width", 512) == "width=512"
    assert wording.setting("overwrite", True) == "overwrite=True"
    assert wording.setting("weights", Path("a b.safetensors")) == 'weights="a b.safetensors"'
    assert wording.setting("extras", ("votes",)) == 'extras=("votes",)'
    assert wording.setting("drop", ("car", "road")) == 'drop=("car", "road")'
    assert wording.setting("recipe.folds", 3) == "folds=3"
    assert wording.share("at_most", 0.05) == "at_most=0.05"
    assert wording.part("topic", "a.bag", "/rear/points") == '"a.bag/rear/points"'
    assert wording.command("predict", wording.setting("limit", 1)) == "predict with limit=1"
    assert wording.command("predict") == "predict"


@pytest.mark.usefixtures("on_command_line")
def test_the_command_line_reads_options():
    assert wording.argument("min_range") == "--min-range"
    assert wording.argument("split", "sequences") == "--split and --sequences"
    assert wording.argument("knn.k") == "--knn-k"
    assert wording.setting("device", "cpu") == "--device cpu"
    assert wording.setting("width", 512) == "--width 512"
    assert wording.setting("overwrite", True) == "--overwrite"
    assert wording.setting("weights", Path("a b.safetensors")) == "--weights 'a b.safetensors'"
    assert wording.setting("extras", ("votes", "pixel_labels")) == "--fuse --pixel-labels"
    assert wording.setting("drop", ("car", "road")) == "--drop car,road"
    assert wording.setting("recipe.folds", 3) == "--set folds=3"
    assert wording.share("at_most", 0.05) == "--at-most 5%"
    assert wording.part("topic", "a.bag", "/rear/points") == "--topic /rear/points"
    assert wording.command("predict", wording.setting("limit", 1)) == "predict --limit 1"


def test_texts_in_python_are_read_back():
    for value in ('a "b" \\ ü', "", ("x",), ("x", "y"), (), 1, 0.5, True, None):
        assert ast.literal_eval(wording.literal(value)) == value


def test_a_body_that_fails_leaves_the_spelling_as_it_was():
    with pytest.raises(ZeroDivisionError), wording.spelled(CommandLine()):
        raise ZeroDivisionError
    assert wording.argument("jobs") == "jobs"


@pytest.mark.parametrize("field", ["k", "window", "sigma", "cutoff"])
def test_a_wrong_value_is_named_as_it_was_given(field, tmp_path):
    refused(UsageError, field, KnnParameters, **{field: -1})
    result = called("knn-refine", tmp_path, f"--knn-{field}", -1, status=2)
    assert subject(result) == f"--knn-{field}"
    # The command leaves Python's words to the next caller.
    refused(UsageError, field, KnnParameters, **{field: -1})


def test_fields_of_records_are_spelled_as_their_options():
    for record, options in OPTIONS.items():
        begin = "knn." if record is KnnParameters else ""
        for name, option in options.items():
            spelled = CommandLine().name(f"{begin}{name}")
            names = option.names or (f"--{name.replace('_', '-')}",)
            assert spelled == names[0]


def spelled_names() -> set[str]:
    """Return the names of arguments that messages of stages, and below, spell."""
    names: set[str] = set()
    for module in MODULES:
        if module.is_relative_to(PACKAGE / "commands/line"):
            continue
        for node in nodes_of(tree_of(module)):
            if not isinstance(node, ast.Call):
                continue
            function = getattr(node.func, "id", getattr(node.func, "attr", ""))
            given = node.args if function == "argument" else node.args[:1]
            if function in SPELLERS:
                names |= {arg.value for arg in given if isinstance(arg, ast.Constant)}
    return names


def parameters_and_fields() -> set[str]:
    """Return the names of arguments of all functions and of fields of all records."""
    names: set[str] = set()
    for module in MODULES:
        if not module.is_relative_to(PACKAGE / "commands/line"):
            nodes = nodes_of(tree_of(module))
            names |= {node.arg for node in nodes if isinstance(node, ast.arg)}
            fields = [node.target for node in nodes if isinstance(node, ast.AnnAssign)]
            names |= {target.id for target in fields if isinstance(target, ast.Name)}
    return names


def test_every_argument_in_a_message_exists_in_python_and_on_the_command_line():
    names = spelled_names()
    assert len(names) > 40
    assert {name.rpartition(".")[2] for name in names} <= parameters_and_fields()
    keys = {name for name in names if name.startswith(RECIPE)}
    assert keys
    assert {key.removeprefix(RECIPE) for key in keys} <= {*Recipe().to_dict()}
    options = {name for word in every_command() for p in parsed(word).params for name in p.opts}
    # The further results of `predict` are options of their own.
    assert {CommandLine().name(name) for name in names - keys - {"extras"}} <= options
    assert {*OPTION_OF_EXTRA.values()} <= options


def test_a_message_of_a_worker_is_spelled_like_those_of_its_run():
    """The two runs may have the same processes."""
    for spelling, name in ((CommandLine(), "--min-range"), (wording.Spelling(), "min_range")):
        assert type(pickle.loads(pickle.dumps(spelling))) is type(spelling)
        names: list[str] = []
        with wording.spelled(spelling):
            options = RunOptions(jobs=2)
            run_over_scans(name_argument, scans_of("a", "b"), options, on_result=names.append)
        assert names == [name, name]


def test_a_hint_of_a_worker_names_an_option_on_the_command_line_only(tmp_path):
    write_sequence(tmp_path / "sequences/00", ["000000", "000001"])
    for path in (tmp_path / "sequences/00/velodyne").iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    result = called("inspect", tmp_path, "--jobs", 2, "--json", status=None)
    hints = [failure["hint"] for failure in only_json(result)["failures"]]
    assert len(hints) == 2
    assert all(hint.endswith("name them with --columns") for hint in hints)
    survey = inspect(tmp_path, sensor=sensor("hdl64"), options=RunOptions(jobs=2))
    assert [failure.hint.rpartition(" ")[2] for failure in survey.failures] == ["columns"] * 2
