# SPDX-License-Identifier: MIT
"""Groups of options: the command line and the arguments of stages."""

import inspect
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pytest
from command_line import logger_as_before, only_json, parsed
from scans import SMALL, labels_below, refused, write_weights
from typer.testing import CliRunner

from salsanext_cli.commands.line.app import app
from salsanext_cli.commands.line.options.expansion import Declared, Default, Without, expanded
from salsanext_cli.commands.line.options.option_fields import DeclarationChange
from salsanext_cli.commands.line.values.typed_values import typed_share
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.io.formats import SCAN_SUFFIXES
from salsanext_cli.io.formats.recording_kinds import RECORDING_KINDS, RECORDING_SUFFIXES
from salsanext_cli.io.weights.card_file import default_weights
from salsanext_cli.runs.network_settings import NetworkSettings, weights_file
from salsanext_cli.runs.scans.scan_selection import ScanSelection


def test_a_group_is_expanded_filled_and_handed_over():
    given = {}

    def command(
        name: str = "x",
        *,
        selection: Annotated[
            ScanSelection,
            Without({"split"}),
            Default(limit=4),
            Declared(limit=DeclarationChange(help="Some.", names=("--subset",))),
        ],
        knn: Annotated[KnnParameters, Without({"window", "sigma", "cutoff"})],
    ) -> None:
        given.update(name=name, selection=selection, knn=knn)

    typed = expanded(command)
    parameters = inspect.signature(typed).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items()}
    assert defaults == {"name": "x", "sequences": None, "limit": 4, "k": 5}
    typed(**defaults | {"sequences": "00", "k": 3})
    assert given["selection"] == ScanSelection(sequences=("00",), limit=4)
    assert given["knn"] == KnnParameters(k=3)


def test_help_lists_the_formats_of_scans_and_the_default_weights_have_a_name():
    (scans,) = (p for p in parsed("predict").params if p.name == "scans")
    listed = re.findall(r" (\.[a-z0-9.]*[a-z0-9])\b", scans.help)
    assert sorted(listed) == sorted((*SCAN_SUFFIXES, *RECORDING_SUFFIXES))
    assert {".bin", ".bag", ".osf"} <= {*listed}
    assert weights_file(Path("default")) == weights_file(None) == default_weights()
    assert weights_file(Path("a/default")) == Path("a/default")


def test_help_lists_the_formats_of_recordings():
    (recording,) = (p for p in parsed("convert").params if p.name == "recording")
    listed = re.findall(r"(\.[a-z0-9]+)\b", recording.help)
    assert sorted(listed) == sorted(RECORDING_SUFFIXES)
    assert all(kind.noun in recording.help for kind in RECORDING_KINDS)


def test_tasks_of_an_array_share_the_scans(run, data, tmp_path, weights, monkeypatch):
    out = tmp_path / "out"
    call = ["predict", data, out, "--weights", weights, "--device", "cpu"]
    for number in (5, 4):
        for name, value in {"ID": number, "MIN": 4, "COUNT": 2}.items():
            monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", str(value))
        result = run(*call, "--json", status=0)
        assert f"shard {number - 3}/2 of the scans" in result.stderr
        assert only_json(result)["done"] == 1
    assert len(labels_below(out)) == 2
    assert only_json(run("eval", out, "--json"))["scans"] == 2
    scans = json.loads((out / "predict.json").read_text())["scans"]
    assert scans["08"]["asked_for"] == ["000000.bin", "000001.bin"]
    # The option takes precedence over the array.
    result = run(*call, "--shard", "1/1", "--json")
    assert only_json(result)["skipped"] == 2


def test_a_named_sensor_sets_its_device_and_nothing_of_the_training(tmp_path):
    """Otherwise the intensity of scans with named columns would not match the training scans."""
    knowing = {"intensity_quantiles": (0.0,) * 64 + (1.0,), "row_gaps": 0.3}
    weights = write_weights(tmp_path / "knowing.safetensors", sensor=replace(SMALL, **knowing))
    preset = NetworkSettings(weights, sensor="hdl32")
    device = {"name": "hdl32", "intensity_scale": 255.0}
    named = replace(SMALL, **device, range_noise=0.02, intensity_noise=0.02)
    assert (preset.named_sensor(), preset.fits_view) == (named, True)
    (tmp_path / "mine.toml").write_text("fov_up = 10\nfov_down = -10\nheight = 8\nwidth = 32\n")
    of_file = NetworkSettings(weights, sensor=str(tmp_path / "mine.toml"))
    named = of_file.named_sensor()
    assert (named.fov_up, named.height, named.means) == (10, 8, SMALL.means)
    assert not of_file.fits_view
    named = NetworkSettings(weights, columns="x,y,z,i").named_sensor()
    assert named == replace(SMALL, columns=("x", "y", "z", "i"))
    assert NetworkSettings(weights).named_sensor() is None


@pytest.mark.parametrize(
    "line",
    [
        "uncertainty --method analytic",
        "uncertainty --method=sampling",
        "eval --backend=loky",
        "tune error data tuned.safetensors --limit 5",
        "eval --split valid --out out",
        "filter out split --split",
        "filter out --drop car --to split",
        "filter out masks --indices",
        "knn-refine out --labels theirs",
        "export-rrd out/",
        "tune int8 data tuned.safetensors --device cpu",
        "tune int8 data tuned.safetensors --precision=float32",
        "tune dropout data tuned.safetensors --lowest 0.1",
        "tune dropout data tuned.safetensors --steps=5",
        "pick data/ picked/ --strategy random",
        "demo --weights mine.safetensors",
        "demo --engine torch",
    ],
)
def test_a_removed_option_is_an_error_that_names_what_to_use(run, line):
    error = only_json(result := run(*line.split(), "--json"))
    assert (result.exit_code, error["code"], bool(error["hint"])) == (2, "usage", True)
    assert error["error"].split(":")[0].split()[0] in line


@pytest.mark.parametrize(
    ("line", "subject_of_error", "meant"),
    [
        ("uncertainty a b --aleatoric papr", "--aleatoric", "--aleatoric paper?"),
        ("predict a b --precision=flot32", "--precision", "--precision float32?"),
        ("predict a b --sensor hdl46", "sensor hdl46", "hdl64?"),
        ("predict a b --classes coars", "coars", "coarse?"),
        ("predict a b --jobs x", "--jobs", "--help"),
        # The word for a value in the help is none of its values.
        ("predict a b --jobs n", "--jobs", "--help"),
        ("predict a b --limit N", "--limit", "--help"),
        ("view --port 99999", "--port", "--help"),
        ("train a b --recipe finetun", "recipe finetun", "finetune?"),
        ("train a b --set lr=1", "--set lr=1", "learning_rate?"),
        ("export-ply a --colour epistem", "--colour", "epistemic?"),
        ("predict a b --reject rsk", "--reject", "risk?"),
        ("predict a b --weights defaults", "defaults", "default?"),
        ("predict a b --subset 1", "salsanext predict", "--limit?"),
        ("predict a b --overwrit", "salsanext predict", "--overwrite?"),
        ("predict a b --set foo=1", "salsanext predict", "--help"),
        ("predict a b -z", "salsanext predict", "--help"),
    ],
)
def test_a_wrong_value_is_answered_by_the_likely_one(run, line, subject_of_error, meant):
    result = run(*line.split(), "--json")
    error = only_json(result)
    assert result.exit_code == (1 if error["code"] == "weights" else 2)
    assert error["error"].split(": ")[0] == subject_of_error
    assert error["hint"].endswith(meant)
    assert "Possible options" not in error["error"]
    assert "Input should" not in error["error"]
    assert "Value error" not in error["error"]


def test_the_likely_weights_are_those_beside_a_wrong_name(run, tmp_path):
    weights = write_weights(tmp_path / "street.safetensors", sensor=SMALL)
    for name, hint in (
        ("stret.safetensors", f"did you mean {weights}?"),
        ("default", "check the name"),
    ):
        error = only_json(
            run("predict", "a", "b", "--weights", tmp_path / name, "--json", status=1)
        )
        assert (error["code"], error["hint"]) == ("weights", hint)


def test_a_word_that_is_no_share_is_answered_by_what_the_option_takes():
    with refused(UsageError, "--reject") as caught:
        typed_share("--reject", "rsk", word="risk")
    assert caught.value.expected.endswith("or risk")
    with refused(UsageError, "--at-most") as caught:
        typed_share("--at-most", "rsk")
    assert "risk" not in caught.value.expected + caught.value.hint


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--objects", {"--objects"}),
        ("--reject risk", {"--reject"}),
        ("--reject 0.1 --objects", {"--objects", "--reject"}),
    ],
)
def test_fuse_names_the_options_that_it_was_given_with(run, data, tmp_path, options, named):
    words = ("predict", data, tmp_path / "out", "--fuse", *options.split(), "--json")
    error = only_json(run(*words, status=2))
    assert error["error"].startswith("--fuse: ")
    assert {*re.findall(r"--(?!fuse)\w+", error["error"])} == named


def test_a_share_above_one_is_answered_by_the_percentage(run):
    for value, meant in (("10", "10%?"), ("5.5", "5.5%?")):
        with refused(UsageError, "--at-most") as caught:
            typed_share("--at-most", value)
        assert caught.value.hint.endswith(meant)
    assert typed_share("--at-most", "10%") == typed_share("--at-most", "0.1") == 0.1
    with refused(UsageError, "--at-most") as caught:
        typed_share("--at-most", "500%")
    assert not caught.value.hint


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("train data run --recipe fi", ["finetune"]),
        ("predict a b --sensor hdl64", ["hdl64", "hdl64-1024", "hdl64-512"]),
        ("predict a b --weights d", ["default"]),
        ("export-ply a --colour entr", ["entropy"]),
        ("predict a b --classes coa", ["coarse"]),
        ("predict a b --precision float", ["float32", "float16"]),
        ("predict a b --sensor ./mi", []),
    ],
)
def test_values_are_completed(line, expected):
    words = f"salsanext {line}"
    environment = {
        "_SALSANEXT_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    with logger_as_before():
        result = CliRunner().invoke(app, [], env=environment, prog_name="salsanext")
    assert result.stdout.split() == expected
