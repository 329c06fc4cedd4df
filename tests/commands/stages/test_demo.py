# SPDX-License-Identifier: MIT
import json
from pathlib import Path

import numpy as np
import pytest
from evaluation_runs import CAR, ROAD, World

from salsanext_cli import read_labels
from salsanext_cli.commands.stages.demo import Demonstration


@pytest.fixture(autouse=True, scope="module")
def narrow():
    """Use the full network, since the default weights have its size."""


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Return a world whose evaluation the demonstration ends with."""
    world = World(tmp_path)
    world.add("000000", [CAR, ROAD], [CAR, CAR])

    def demo(*_, **__):
        return Demonstration(
            evaluation=world.evaluate(), pictures=(), page=world.out / "report.html", failures=()
        )

    monkeypatch.setattr("salsanext_cli.commands.stages.demo.demo", demo)
    return world


@pytest.mark.parametrize(
    ("predicted", "status"), [([CAR, ROAD], 0), ([CAR], 1), (None, 1)], ids=["2", "1", "none"]
)
def test_a_scan_that_cannot_be_evaluated_is_an_error(run, world, predicted, status):
    world.add("000001", [CAR, ROAD], predicted)
    result = run("demo")
    assert result.exit_code == status, result.output
    assert ("error: " in result.stderr) == bool(status)


@pytest.mark.slow
def test_the_demonstration_writes_scores_pictures_and_a_page(run, tmp_path):
    result = run("demo", tmp_path, "--scans", "1", "--samples", "2", "--json", status=0)
    printed = json.loads(result.stdout)
    assert printed["uncertainty"]["error"]["auroc"] > 0.5
    (error,) = (tmp_path / "out/sequences/00/uncertainty/error").iterdir()
    labels = tmp_path / "out/sequences/00/predictions" / f"{error.stem}.label"
    assert np.load(error).shape == read_labels(labels).shape
    assert [Path(picture).stat().st_size > 0 for picture in printed["pictures"]] == [True]
    assert Path(printed["page"]).stat().st_size > 0
