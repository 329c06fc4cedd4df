# SPDX-License-Identifier: MIT
import json
from pathlib import Path

import numpy as np
import pytest
from evaluated import CAR, ROAD, World

from salsanext_cli import read_labels
from salsanext_cli.stages.demo import Demonstration


@pytest.fixture(autouse=True, scope="module")
def narrow():
    """Leave the network as it is: the default weights are of its size."""


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Return a world whose evaluation the demonstration ends with."""
    world = World(tmp_path)
    world.add("000000", [CAR, ROAD], [CAR, CAR])

    def demo(*_, **__):
        return Demonstration(world.evaluate(), (), world.out / "report.html", ())

    monkeypatch.setattr("salsanext_cli.stages.demo.demo", demo)
    return world


@pytest.mark.parametrize(
    ("predicted", "status", "says"),
    [
        ([CAR, ROAD], 0, ""),
        ([CAR], 1, "000001.label: 1 label"),
        (None, 1, "error: 1 of 2 scans have no predictions"),
    ],
)
def test_a_scan_that_cannot_be_evaluated_is_named_and_status_one(
    run, world, predicted, status, says
):
    world.add("000001", [CAR, ROAD], predicted)
    result = run("demo")
    assert result.exit_code == status, result.output
    assert says in result.stderr
    assert ("error: " in result.stderr) == bool(status)


@pytest.mark.slow
def test_the_whole_of_it_shows_the_probability_of_errors(run, tmp_path):
    result = run("demo", tmp_path, "--scans", "1", "--samples", "2", "--json")
    assert result.exit_code == 0, result.stderr
    made = json.loads(result.stdout)
    assert made["uncertainty"]["error"]["auroc"] > 0.5
    (error,) = (tmp_path / "out/sequences/00/uncertainty/error").iterdir()
    labels = tmp_path / "out/sequences/00/predictions" / f"{error.stem}.label"
    assert np.load(error).shape == read_labels(labels).shape
    assert [Path(picture).stat().st_size > 0 for picture in made["pictures"]] == [True]
    assert Path(made["page"]).stat().st_size > 0
