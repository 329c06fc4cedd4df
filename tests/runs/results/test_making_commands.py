# SPDX-License-Identifier: MIT
"""Commands in hints about missing results: followed as printed, they continue the same run."""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from shutil import copyfile, copytree

import numpy as np
import pytest
import yaml
from command_line import called
from scans import SMALL
from world import World

from salsanext_cli import label_space
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.results.making_commands import (
    FUSE,
    PREDICT,
    UNCERTAINTY_STAGE,
    MakingCommand,
    making_hint,
)
from salsanext_cli.runs.results.manifest import Manifest, ScanSource, StageRecord
from salsanext_cli.runs.results.merged_labels import hint_for_error
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_search import find_scans

PROBABILITIES = MakingCommand(stage="predict", extras=("probabilities",))
FEW_SAMPLES = ("--samples", 2, "--aleatoric", "none")
"""Options of `uncertainty`, whose other results take several times as long."""


def words_of(making: MakingCommand, out, scans=(), **changes) -> list[str]:
    """Return the words of a command as they are typed."""
    with spelled(CommandLine()):
        return shlex.split(making.text(out, scans, **changes))


@pytest.fixture
def run_with_options(world: World, tmp_path, monkeypatch) -> World:
    """Predict with weights, a sensor file and other options, which a hint must repeat."""
    monkeypatch.chdir(tmp_path)
    sensor = replace(SMALL, fov_up=4.0)
    (tmp_path / "my sensor.toml").write_text(sensor.to_toml())
    options = ("--sensor", "my sensor.toml", "--width", 64, "--min-range", 2, "--knn-k", 3)
    network = ("--weights", world.network.weights, "--engine", "torch", "--precision", "float32")
    called("predict", world.data, world.out, *options, *network, "--objects")
    return world


def test_a_hint_about_missing_results_continues_the_same_run(run_with_options):
    world = run_with_options
    words = words_of(PROBABILITIES, world.out, find_scans(world.data))
    assert words[:4] == ["salsanext", "predict", str(world.data), str(world.out)]
    for option, value in {"--sensor": "my sensor.toml", "--width": "64", "--knn-k": "3"}.items():
        assert words[words.index(option) + 1] == value
    called(*words[1:])
    assert len(find_outputs(world.out, "probabilities")) == 3
    # Without the options, the settings are others.
    called("predict", world.data, world.out, "--weights", world.network.weights, status=1)


def test_a_hint_names_no_more_than_the_scans_that_the_run_was_asked_for(world):
    folder = find_scans(world.data, ["08"])[0].path.parent
    for number in (2, 3, 4):
        copyfile(folder / "000001.bin", folder / f"{number:06d}.bin")
    weights = ("--weights", world.network.weights, "--engine", "torch")
    called("predict", world.data, world.out, "--limit", 4, *weights)
    words = words_of(UNCERTAINTY_STAGE, world.out, find_scans(folder))
    called(*words[1:], *FEW_SAMPLES)
    names = [("00", "000000"), ("08", "000000"), ("08", "000001"), ("08", "000002")]
    assert [*find_outputs(world.out, "uncertainty/epistemic")] == names


def test_results_of_moved_scans_are_made_in_another_folder(world, tmp_path):
    files = [scan.path for scan in find_scans(world.data)][:2]
    weights = ("--weights", world.network.weights, "--engine", "torch")
    called("predict", *files, world.out, *weights)
    moved = world.data.rename(tmp_path / "moved")
    options = ("--colour", "entropy", "--dataset", moved)
    missing = called("export-ply", world.out, *options, status=1)
    hint = re.search(r"^hint: run `salsanext (.+)`, then give (.+)$", missing.stderr, re.M)
    (target,) = shlex.split(hint[2])
    called(*shlex.split(hint[1]), *FEW_SAMPLES)
    called("export-ply", target, *options)
    assert [*find_outputs(Path(target), "ply")] == [("00", "000000"), ("08", "000000")]
    # The same folder takes no results of scans that may be others of the same names.
    with spelled(CommandLine()):
        refused = PREDICT.text(world.out, find_scans(moved), target=world.out)
    called(*shlex.split(refused)[1:], status=1)


@pytest.mark.parametrize(
    ("folders", "data_set"),
    [(["sequences/00/velodyne"], ""), (["plain"], "plain"), (["d1/velodyne", "d2/velodyne"], "")],
)
def test_moved_scans_are_fused_where_they_are(tmp_path, folders, data_set):
    old = tmp_path / "old data"
    for folder in folders:
        (old / folder).mkdir(parents=True)
        (old / folder / "000000.bin").touch()
    scans = find_scans(old / data_set)
    folder_by_sequence = {scan.sequence: str(scan.path.parent) for scan in scans}
    assert len(folder_by_sequence) == len(folders)
    suffixes = {"000000": ".bin"}
    sources = {name: ScanSource(path, suffixes) for name, path in folder_by_sequence.items()}
    out = tmp_path / "out"
    out.mkdir()
    Manifest(out).write(StageRecord(stage="predict", settings={}, scans=sources))
    assert words_of(FUSE, out, scans[:1]) == ["salsanext", "fuse", str(out)]
    copied = copytree(old, tmp_path / "copy")
    first = find_scans(copied / data_set)[:1]
    assert words_of(FUSE, out, first) == ["salsanext", "fuse", str(out)], "others are refused"
    moved = old.rename(tmp_path / "new data") / data_set
    first = find_scans(moved)[:1]
    assert words_of(FUSE, out, first)[2:] == [str(out), "--dataset", str(moved)]


def test_the_uncertainty_is_that_of_the_network_of_the_labels(run_with_options):
    world = run_with_options
    words = words_of(UNCERTAINTY_STAGE, world.out, find_scans(world.data))
    assert "--objects" not in words
    called(*words[1:], *FEW_SAMPLES)
    assert len(find_outputs(world.out, "uncertainty/epistemic")) == 3


@pytest.mark.parametrize(
    ("typed", "kind", "repeated"),
    [
        (
            "--samples 2 --seed 7 --aleatoric paper",
            "total",
            "--samples 2 --seed 7 --aleatoric paper",
        ),
        ("--samples 2 --aleatoric none", "entropy", "--samples 2 --aleatoric none"),
        ("--samples 2 --aleatoric none", "aleatoric", "--samples 2 --overwrite"),
    ],
)
def test_a_hint_about_the_uncertainty_repeats_its_samples(world, tmp_path, typed, kind, repeated):
    record = {"stage": "uncertainty", "settings": {}}
    options = dict(zip(typed.split()[::2], typed.split()[1::2], strict=True))
    for option, value in options.items():
        record["settings"][option[2:]] = int(value) if value.isdecimal() else value
    (tmp_path / "uncertainty.json").write_text(json.dumps(record))
    with spelled(CommandLine()):
        hint = making_hint(kind, tmp_path)
    assert hint.endswith(f" SCANS {tmp_path} {repeated}` first")


def test_a_run_with_the_defaults_needs_no_options(world, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "salsanext_cli.runs.results.repeated_settings.default_weights",
        lambda: world.network.weights,
    )
    assert words_of(PREDICT, tmp_path) == ["salsanext", "predict", "SCANS", str(tmp_path)]
    world.predict()
    # Python computes in float32 unless it is told otherwise.
    repeated = ["--precision", "float32", "--engine", "torch"]
    assert words_of(PREDICT, world.out) == [
        *("salsanext", "predict", "SCANS", str(world.out)),
        *repeated,
    ]
    assert words_of(PREDICT, world.out, overwrite=True)[-1] == "--overwrite"
    assert words_of(FUSE, world.out) == ["salsanext", "fuse", str(world.out)]


def test_the_hint_about_the_error_names_its_option(world):
    world.predict()
    with spelled(CommandLine()):
        assert " --error`" in making_hint("error", world.out, find_scans(world.data))
        assert making_hint("entropy", world.out).startswith("run `salsanext uncertainty SCANS ")


@pytest.mark.parametrize("classes", ["coarse", "my classes.yaml"])
def test_the_hint_of_fuse_can_be_followed_with_merged_classes(
    world, tmp_path, monkeypatch, classes
):
    monkeypatch.chdir(tmp_path)
    merged = label_space("coarse").to_dict() | {"name": "mine"}
    (tmp_path / "my classes.yaml").write_text(yaml.safe_dump(merged))
    network = ("--weights", world.network.weights, "--engine", "torch")
    called("predict", world.data, world.out, "--classes", classes, *network)
    refused = called("fuse", world.out, status=1)
    command = re.search(r"^hint: run `salsanext (.+?)`, or with (--\w+)$", refused.stderr, re.M)
    words = shlex.split(command[1])
    assert words[words.index("--classes") + 1] == classes
    # Without poses of the scans, nothing can be fused.
    called(*(command[2] if word == "--fuse" else word for word in words))
    assert len(find_outputs(world.out, "probabilities")) == 3
    called(*words_of(UNCERTAINTY_STAGE, world.out, find_scans(world.data))[1:], *FEW_SAMPLES)
    with spelled(CommandLine()):
        hint = hint_for_error(world.out, find_scans(world.data)[0])
    # Merged labels have no probability of error.
    assert "--error" in hint
    assert "--classes" not in hint


def test_a_hint_states_the_origin_as_it_was_typed(world, tmp_path):
    origin = "-0.5,0.25,0.125"
    network = ("--weights", world.network.weights, "--engine", "torch")
    called("predict", world.data, world.out, "--origin", origin, *network)
    recorded = Provenance(world.out).sensor()
    assert recorded.origin == (-0.5, 0.25, 0.125)
    file = find_scans(world.data)[0]
    other = tmp_path / "other"
    called(*words_of(PREDICT, world.out, [file], overwrite=True)[1:])
    called(*words_of(PREDICT, world.out, [file], target=other)[1:])
    for out in (world.out, other):
        assert Provenance(out).sensor() == recorded
    for path in world.out.rglob("*.label"):
        again = np.fromfile(other / path.relative_to(world.out), "<u4")
        assert np.array_equal(np.fromfile(path, "<u4"), again)
    # `uncertainty` takes the recorded sensor, and has no such option.
    called(*words_of(UNCERTAINTY_STAGE, world.out, [file])[1:], *FEW_SAMPLES)
    assert Provenance(world.out).sensor() == recorded
