# SPDX-License-Identifier: MIT
"""Points of the housing of the sensor and of its vehicle stay unlabelled, with a note."""

import re
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest
from command_line import called, only_json
from scans import HOUSING as NEAR
from scans import SMALL, labels_below, write_bin

from salsanext_cli import Scan, read_labels


def typed(world, line, out=None, status=0):
    """Run a command line with the scans for DATA, the results for OUT and small weights."""
    places = {"DATA": world.data, "OUT": out or world.out, "WEIGHTS": world.network.weights}
    line = line.replace("predict", "predict --engine torch --weights WEIGHTS")
    return called(*(places.get(word, word) for word in shlex.split(line)), status=status)


def world_labels(world):
    return sorted(world.out.rglob("*.label"))


def unlabelled(world):
    labels = [read_labels(path) for path in world_labels(world)]
    return [(scan[:NEAR] == 0).mean() for scan in labels], [scan[NEAR:] for scan in labels]


def test_the_housing_is_unlabelled_with_a_note(housed):
    result = typed(housed, "predict DATA OUT")
    shares, others = unlabelled(housed)
    assert shares == [1.0] * 3
    assert np.mean(np.concatenate(others) > 0) > 0.9
    (numbers,) = re.findall(r"unlabelled: ([\d.]+) % .*\(([\d.]+) %", result.stderr)
    labels = np.concatenate([read_labels(path) for path in world_labels(housed)])
    assert float(numbers[0]) == pytest.approx(100 * (labels == 0).mean(), abs=0.05)
    assert numbers[1] == f"{100 * NEAR / (NEAR + 1500):.1f}"
    (classes,) = (line for line in result.stderr.splitlines() if line.startswith("largest "))
    assert "unlabeled" not in classes
    assert "nearer than 1 m" in result.stderr


@pytest.mark.parametrize(
    ("count", "options", "is_said"), [(4, "", True), (5, "", False), (4, "--ego none", False)]
)
def test_a_search_for_the_vehicle_that_needs_more_scans_is_said(
    housed, tmp_path, count, options, is_said
):
    scan = next(housed.data.rglob("*.bin"))
    for number in range(count):
        (tmp_path / "few").mkdir(exist_ok=True)
        shutil.copy(scan, tmp_path / f"few/{number}.bin")
    result = typed(housed, f"predict '{tmp_path / 'few'}' OUT {options}")
    said = [line for line in result.stderr.splitlines() if "not searched for" in line]
    assert len(said) == is_said
    assert all(f"in {count} scans" in line and "--ego" in line for line in said)


def test_a_sensor_file_keeps_its_minimum_range(housed, tmp_path):
    (tmp_path / "own.toml").write_text(replace(SMALL, min_range=0.1).to_toml())
    result = typed(housed, f"predict DATA OUT --sensor '{tmp_path / 'own.toml'}'")
    assert unlabelled(housed)[0] == pytest.approx([0] * 3, abs=0.5)
    assert "nearer than 1 m" not in result.stderr


def test_the_same_labels_step_by_step(housed, tmp_path):
    typed(housed, "predict DATA OUT")
    for line in ("project DATA OUT --weights WEIGHTS", "predict OUT OUT", "knn-refine OUT"):
        typed(housed, line, tmp_path / "steps")
    assert labels_below(tmp_path / "steps") == labels_below(housed.out)


def test_options_set_the_ego_points_of_all_results(housed):
    typed(housed, "predict DATA OUT --limit 1")
    assert "min_range" in typed(housed, "predict DATA OUT --min-range 0", status=1).stderr
    result = typed(housed, "predict DATA OUT --min-range 0 --json --overwrite")
    assert only_json(result)["ego_share"] == 0
    assert max(unlabelled(housed)[0]) < 1
    boxed = "predict DATA OUT --min-range 0 --ego=-1,-1,-1,1,1,1 --json --overwrite"
    summary = only_json(typed(housed, boxed))
    assert summary["ego_share"] == round(NEAR / (NEAR + 1500), 4)
    assert summary["sensor"]["ego_box"] == [-1, -1, -1, 1, 1, 1]


@pytest.mark.parametrize("command", ["predict", "uncertainty --samples 2", "project"])
def test_the_share_of_the_housing_is_counted_in_scans_larger_than_a_sample(world, command):
    """A count of a sample would differ by some tenths of a percent."""
    sizes = (600, 4000, 7400)
    turns = np.random.default_rng(0)
    for path, size in zip(sorted(world.data.rglob("*.bin")), sizes, strict=True):
        ahead = turns.normal(size=(6000, 3))
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        ranges = np.where(np.arange(6000) < size / 2, 0.5, 12)[:, None]
        write_bin(path, Scan((ahead * ranges).astype(np.float32), np.ones(6000, np.float32)))
    for folder in [*world.data.rglob("labels")]:
        shutil.rmtree(folder)
    name, *options = command.split()
    given = ("--weights", world.network.weights, *options)
    of_images = ("--sensor", "hdl64", "--min-range", "1")
    given = (*given, *(of_images if name == "project" else ("--engine", "torch")))
    result = called(name, world.data, world.out, *given, "--json")
    assert only_json(result)["ego_share"] == round(sum(sizes) / 2 / (3 * 6000), 4)
