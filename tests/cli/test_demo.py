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
        return Demonstration(world.dataset, world.out, world.evaluate(), (), ())

    monkeypatch.setattr("salsanext_cli.stages.demo.demo", demo)
    return world


def test_a_demonstration_that_works_is_status_zero(run, world):
    result = run("demo")
    assert result.exit_code == 0, result.output
    assert "error" not in result.stderr


def test_a_scan_that_cannot_be_evaluated_is_named_and_status_one(run, world):
    world.add("000001", [CAR, ROAD], [CAR])
    result = run("demo")
    assert result.exit_code == 1
    assert "error: " in result.stderr
    assert "000001.label · 1 labels" in result.stderr


def test_a_scan_without_predictions_is_status_one(run, world):
    world.add("000001", [CAR, ROAD], None)
    result = run("demo")
    assert result.exit_code == 1
    assert "error: 1 of 2 scans have no predictions" in result.stderr
