# SPDX-License-Identifier: MIT
import pytest
from evaluated import CAR, ROAD, World

from salsanext_cli.stages.demo import Demonstration


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
        ([CAR], 1, "000001.label · 1 label"),
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
