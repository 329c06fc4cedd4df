# SPDX-License-Identifier: MIT
"""Options from a file: what is typed wins, then variables, then the file, then the defaults."""

import json

import pytest
from command_line import only_json, parsed, subject

from salsanext_cli.commands.line.options.options_file import (
    COMMANDS_WITH_FILE,
    EXCLUSIVE,
    FILE,
    ONLY_TYPED,
)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Work in an empty folder without variables of salsanext."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("DATASET", "OUT", "PRECISION", "ENGINE", "CLUSTER"):
        monkeypatch.delenv(f"SALSANEXT_{name}", raising=False)
    return folder


def context_of(command, words=()):
    """Return the context of a parsed command, as its function gets it."""
    program = parsed("").make_context("salsanext", [command], resilient_parsing=True)
    return parsed(command).make_context(command, [*words], parent=program)


def values_of(command, *words):
    return context_of(command, words).params


def test_what_is_typed_wins_then_variables_then_the_file(here, monkeypatch):
    assert (values_of("predict")["precision"], values_of("predict")["width"]) == ("auto", None)
    FILE.write_text('precision = "int8"\nwidth = 512\nerror = true\n')
    assert [values_of("predict")[name] for name in ("precision", "width", "error")] == [
        "int8",
        512,
        True,
    ]
    monkeypatch.setenv("SALSANEXT_PRECISION", "float32")
    assert values_of("predict")["precision"] == "float32"
    assert values_of("predict", "--precision", "bfloat16")["precision"] == "bfloat16"
    assert values_of("predict", "--width=1024")["width"] == 1024


def test_commands_take_their_options_and_their_table_wins(here):
    FILE.write_text(
        'weights = "a.safetensors"\nsplit = "valid"\ncount = 5\nby-distance = true\n'
        'labelled = ["x", "y"]\nsequences = ["00", "08"]\nego = [-1, -1.5, 0, 1, 1, 2]\n'
        "[pick]\ncount = 7\nsplit = 'train'\n[predict]\nlimit = 3\n"
    )
    predicted = values_of("predict")
    assert (str(predicted["weights"]), predicted["split"]) == ("a.safetensors", "valid")
    assert (predicted["limit"], predicted["sequences"]) == (3, "00,08")
    assert predicted["ego"] == "-1,-1.5,0,1,1,2"
    picked = values_of("pick", "data", "out")
    assert (picked["count"], picked["split"], picked["limit"]) == (7, "train", None)
    assert [str(path) for path in picked["labelled"]] == ["x", "y"]
    evaluated = values_of("eval")
    assert (evaluated["split"], evaluated["by_distance"], evaluated["limit"]) == (
        "valid",
        True,
        None,
    )
    # Other commands do not read it.
    assert values_of("inspect")["split"] is None


@pytest.mark.parametrize(
    ("content", "named", "meant"),
    [
        ("widh = 512", "widh", "width?"),
        ("min_range = 1.0", "min_range", "min-range?"),
        ("[pick]\nwidh = 512", "[pick] widh", "width?"),
        ("[eval]\nweights = 'a'", "[eval] weights", ""),
        ("[predct]\nlimit = 1", "predct", "predict?"),
        ("[inspect]\nlimit = 1", "inspect", ""),
        ("predict = 1", "predict", ""),
        ("overwrite = true", "overwrite", "--overwrite"),
        ("cluster = 'auto'", "cluster", "--cluster"),
        ("scans = 'data'", "scans", ""),
        ("width = '5x'", "width", "--help"),
        ("width = 512.5", "width", "--help"),
        ("width = true", "width", "--help"),
        ("width = [512, 1024]", "width", "--help"),
        ("error = 'yes'", "error", "--help"),
        ("error = 1", "error", "--help"),
        ("precision = 'flot32'", "precision", "--help"),
        ("weights = 2020-01-01", "weights", "--help"),
        ("labelled = [[1]]", "labelled", "--help"),
        ("width = 512\nwidth = 1024", "", ""),
        ("width", "", ""),
        ("\0", "", ""),
    ],
)
def test_unknown_keys_and_values_are_refused(run, here, content, named, meant):
    FILE.write_text(content)
    command = ("pick", "data", "out") if "labelled" in content else ("predict",)
    refused = run(*command, "--json")
    assert (refused.exit_code, subject(refused)) == (2, str(FILE))
    error = only_json(refused)
    assert error["code"] == "usage"
    assert f"{FILE}: {named}" in error["error"]
    assert meant in error["hint"]
    assert run(*command, "--help").exit_code == 0
    assert run(*command, "--help-all").exit_code == 0


def test_a_folder_of_this_name_is_refused(run, here):
    FILE.mkdir()
    refused = run("predict", "--json")
    assert (refused.exit_code, subject(refused)) == (2, str(FILE))


def test_what_is_typed_replaces_an_option_of_the_file_that_it_excludes(here, monkeypatch, capsys):
    FILE.write_text('split = "valid"\njobs = 4\n')
    values = values_of("predict", "--sequences", "00")
    assert (values["split"], values["sequences"], values["jobs"]) == (None, "00", "4")
    assert "--split" not in capsys.readouterr().err
    monkeypatch.setenv("SALSANEXT_CLUSTER", "auto")
    values = values_of("predict")
    assert (values["jobs"], values["cluster"], values["split"]) == (None, "auto", "valid")
    values = values_of("predict", "--jobs", "2")
    assert (values["jobs"], values["cluster"]) == ("2", None)


def test_the_data_set_of_the_variable_wins_also_for_eval(here, monkeypatch):
    FILE.write_text('dataset = "a"\n')
    for command in ("predict", "eval"):
        assert str(values_of(command)["dataset"]) == "a"
    monkeypatch.setenv("SALSANEXT_DATASET", "b")
    assert str(values_of("predict")["dataset"]) == "b"
    assert values_of("eval")["dataset"] is None


def test_sources_are_printed(here, monkeypatch, capsys):
    FILE.write_text('width = 512\nsequences = "a b"\nerror = true\n')
    values_of("predict", "--knn-k", "3")
    used = f"options of {FILE}: --error --sequences 'a b' --width 512\n"
    assert capsys.readouterr().err == used
    values_of("predict", "--quiet")
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    values_of("predict", "--verbose", "--knn-k", "3")
    assert set(capsys.readouterr().err.splitlines()) == {
        used.strip(),
        "options of SALSANEXT_ENGINE: --engine torch",
        "options of command line: --knn-k 3",
    }
    FILE.unlink()
    values_of("predict")
    assert capsys.readouterr().err == ""


def test_a_run_from_the_file_is_the_same_run(run, data, weights, here):
    typed = ("--weights", weights, "--device", "cpu", "--engine", "torch", "--limit", 1)
    first = only_json(run("predict", data, "out", *typed, "--json", status=0))
    content = f"weights = {json.dumps(str(weights))}\ndevice = 'cpu'\nengine = 'torch'\nlimit = 1\n"
    FILE.write_text(f"{content}fail-over = 'ece=100'\n")
    again = only_json(run("predict", data, "out", "--json", status=0))
    assert (first["done"], again["done"], again["skipped"]) == (1, 0, 1)
    evaluated = only_json(run("eval", "out", "--json"))
    assert (evaluated["scans"], evaluated["above"]) == (1, ["ece"])


def test_the_names_in_the_rules_are_options():
    offered = {
        parameter.name for command in COMMANDS_WITH_FILE for parameter in parsed(command).params
    }
    assert offered >= ONLY_TYPED
    assert offered >= {name for pair in EXCLUSIVE for name in pair}
