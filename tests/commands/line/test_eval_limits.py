# SPDX-License-Identifier: MIT
"""Exit status of `eval` with limits on scores and on the guarantee of a run."""

from dataclasses import replace

import pytest
from command_line import only_json, subject
from evaluation_runs import CAR, ROAD, SPACE, World

from salsanext_cli import sensor
from salsanext_cli.core.geometry.scan_measures import MEASURES
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.plain_data import plain
from salsanext_cli.runs.results.manifest import Manifest, StageRecord

NONE = 0
UNIT = UnitTraits(
    unit="a/0", uncertainty=0.1, class_shares=(0.5, 0.5), measures=(1.0,) * len(MEASURES)
)
RISK = RiskThreshold("least_confidence", 0.25, 0.2, None, 99, ("a", "b"), population=(UNIT,) * 99)


@pytest.fixture
def world(tmp_path):
    """Return a run that rejected points: a quarter of the points is accepted and wrong."""
    world = World(tmp_path)
    world.add("000000", [ROAD, ROAD, CAR, CAR], [ROAD, CAR, NONE, CAR])
    return world


@pytest.fixture
def evaluated(run, world):
    """Return a function that evaluates the run with further options."""
    return lambda *options, status: run(
        "eval", world.out, "--dataset", world.dataset, "--json", *options, status=status
    )


def record(world, **settings):
    settings |= {"label_space": SPACE.to_dict(), "sensor": sensor("hdl64").to_dict()}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )


def test_eval_fails_if_a_score_misses_its_limit(world, evaluated):
    plain_result = only_json(evaluated(status=0))
    assert not {"below", "above"} & plain_result.keys()
    reached = only_json(evaluated("--fail-under", "accuracy=50,iou.road=50", status=0))
    assert reached["below"] == []
    low = only_json(evaluated("--fail-under", "accuracy=51,iou.car=34,iou.road=50", status=1))
    assert low["below"] == ["accuracy", "iou.car"]
    unknown = evaluated("--fail-under", "iou.person=1", "--fail-over", "ece=5", status=1)
    assert only_json(unknown).items() >= {"below": ["iou.person"], "above": ["ece"]}.items()
    assert "hint: run `salsanext predict` with --probabilities" in unknown.stderr


def test_a_limit_on_an_unknown_class_is_refused_before_the_work(world, evaluated):
    result = evaluated("--fail-under", "iou.rode=50", status=2)
    assert subject(result) == "limit of iou.rode"
    assert result.stderr.endswith("hint: did you mean road?\n")
    assert not (world.out / "eval.json").exists()


def test_an_exceeded_guarantee_fails_if_it_is_a_limit(world, evaluated):
    record(world, reject=0.25, guarantee=plain(RISK))
    warned = evaluated(status=0)
    assert "warning: the share of accepted and wrong points exceeds the limit" in warned.stderr
    failed = evaluated("--fail-over", "guarantee", status=1)
    assert only_json(failed)["above"] == ["guarantee"]
    assert "error: --fail-over guarantee: 25 %, above the limit of 20 %\n" in failed.stderr


def test_a_kept_guarantee_passes_and_an_absent_one_fails(world, evaluated):
    record(world, reject=0.25, guarantee=plain(RISK) | {"at_most": 0.25})
    kept = evaluated("--fail-over", "guarantee,risk=34", status=0)
    assert only_json(kept)["above"] == []
    lines = [line for line in kept.stderr.splitlines() if line.startswith("--fail-over ")]
    assert lines == [
        "--fail-over guarantee: 25 %, not above the limit of 25 %",
        "--fail-over risk: 33.33 %, not above the limit of 34 %",
    ]
    record(world, reject=0.25)
    assert only_json(evaluated("--fail-over", "guarantee", status=1))["above"] == ["guarantee"]


@pytest.mark.parametrize("population", [(UNIT,) * 98, (replace(UNIT, measures=()),) * 99, ()])
def test_a_guarantee_that_cannot_be_compared_is_missed(world, evaluated, population):
    kept = replace(RISK, at_most=0.25, population=population)
    record(world, reject=0.25, guarantee=plain(kept))
    assert only_json(evaluated("--fail-over", "guarantee", status=1))["above"] == ["guarantee"]
