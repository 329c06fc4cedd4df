# SPDX-License-Identifier: MIT
import json
import logging

import numpy as np
import pytest
from evaluation_runs import CAR, ROAD, SPACE, World
from scans import write_array

from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.core.measures.counts import EVALUATED_KINDS, ScanCounts
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.summary.comparison import ScanComparison

C = SPACE.class_count
CAR_ID, ROAD_ID = SPACE.names.index("car"), SPACE.names.index("road")
PICTURES = {
    "probabilities": {"eval_reliability.png", "eval_risk_coverage.png"},
    "uncertainty/epistemic": {"eval_risk_coverage.png"},
}
ALWAYS = {"scores.txt", "eval.json", "eval_iou.png", "eval_confusion.png"}


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def softmax(*cars: float) -> np.ndarray:
    """Return a row per probability of a car, the rest being road."""
    rows = np.zeros((len(cars), C), np.float16)
    rows[:, CAR_ID] = cars
    rows[:, ROAD_ID] = 1 - rows[:, CAR_ID]
    return rows


def random_scan(world: World, stem: str, count: int, distance: float = 5) -> None:
    """Add a scan with every kind of file; the uncertain points are wrong more often."""
    rng = np.random.default_rng(int(stem))
    truth = rng.choice([CAR, ROAD, 0], count, p=[0.5, 0.4, 0.1])
    uncertainty = np.exp(rng.normal(-3, 1, count))
    wrong = rng.random(count) < np.clip(4 * uncertainty, 0, 0.9)
    predicted = np.where(wrong, np.where(truth == CAR, ROAD, CAR), truth)
    world.add(stem, truth, predicted, distance=distance)
    doubt = np.clip(uncertainty, 0, 0.5)
    cars = np.where(predicted == CAR, 1 - doubt, doubt)
    world.put("probabilities", stem, softmax(*cars))
    for i, kind in enumerate(UNCERTAINTY):
        values = uncertainty ** (i + 1)
        values[::7] = np.nan
        world.put(f"uncertainty/{kind}", stem, values)


def uncertainty_of(world: World) -> UncertaintyEvaluation:
    """Count and divide without drawing anything."""
    counts = ScanCounts.none(SPACE)
    comparison = ScanComparison.from_results(Provenance(world.out), SPACE, SPACE)
    for scan in find_scans(world.dataset):
        counts.add(comparison.count(scan))
    return UncertaintyEvaluation.from_counts(counts)


def report_of(world: World) -> dict:
    return json.loads((world.out / "eval.json").read_text())


@pytest.mark.parametrize("folder", PICTURES)
def test_available_files_are_evaluated(world, folder):
    world.add("000000", [CAR, ROAD], [CAR, CAR])
    scores = world.evaluate() and (world.out / "scores.txt").read_bytes()
    world.put(folder, "000000", softmax(1, 0.25) if folder == "probabilities" else [0.1, 0.2])
    world.evaluate()
    files = {path.name for path in world.out.iterdir() if path.is_file()}
    assert files == ALWAYS | PICTURES[folder]
    assert (world.out / "scores.txt").read_bytes() == scores
    report = report_of(world)
    assert (report["calibration"] is not None) == (folder == "probabilities")
    kinds = ["least_confidence", "softmax_entropy"] if folder == "probabilities" else [folder[12:]]
    assert list(report["uncertainty"]) == kinds


def test_the_error_per_scan_is_the_mean_over_the_scans_that_have_points(world):
    """Errors of a confident and of an unconfident scan cancel out when they are pooled."""
    for stem, truth in (("000000", [ROAD] * 10), ("000001", [0]), ("000002", [CAR] * 10)):
        world.add(stem, truth, truth)
        world.put("probabilities", stem, softmax(*[0.5] * len(truth)))
    calibration = uncertainty_of(world).calibration
    assert (calibration.ece_per_scan, calibration.scans) == (0.5, 2)
    assert calibration.ece == 0


def test_files_of_some_scans_are_used_with_a_warning(world, caplog):
    for i in range(4):
        world.add(f"{i:06d}", [CAR, ROAD], [CAR, CAR])
    for i in (0, 3):
        world.put("uncertainty/epistemic", f"{i:06d}", [0.1, 0.2])
    world.put("probabilities", "000001", softmax(0.75, 0.75))
    with caplog.at_level(logging.WARNING):
        evaluation = uncertainty_of(world)
    assert evaluation.kinds["epistemic"].scans == 2
    assert evaluation.kinds["epistemic"].points == 4
    assert evaluation.calibration.scans == 1
    softmax_warning, epistemic_warning = caplog.messages
    assert "1 of 4" in softmax_warning
    assert "2 of 4" in epistemic_warning


BAD = {"probabilities": np.full((2, 3), 1 / 3, "f2"), "uncertainty/error": np.float32([0.5, 1.5])}


@pytest.mark.parametrize("folder", BAD)
def test_a_bad_file_is_a_failure_and_the_other_scans_are_scored(world, folder):
    for stem in ("000000", "000001"):
        world.add(stem, [CAR, ROAD], [CAR, ROAD])
        world.put(folder, stem, softmax(1, 0) if folder == "probabilities" else [0.1, 0.2])
    path = output_path(world.out, "08", folder, "000001")
    write_array(path, BAD[folder])
    evaluation = world.evaluate()
    assert evaluation.counts.scans == 1
    (failure,) = evaluation.failures
    assert failure.reason.startswith(f"{path}: ")


@pytest.mark.usefixtures("workers_in_process")
def test_the_report_does_not_depend_on_jobs_or_order(world):
    """Float64 sums in the order of the results would differ in the last digit."""
    for i in range(5):
        random_scan(world, f"{i:06d}", 400 + i, distance=5 + 10 * i)
    scans = find_scans(world.dataset)
    evaluate_scans(scans, world.out, SPACE, by_distance=True)
    once = (world.out / "eval.json").read_bytes()
    evaluate_scans(scans[::-1], world.out, SPACE, RunOptions(jobs=2), by_distance=True)
    assert (world.out / "eval.json").read_bytes() == once
    assert list(report_of(world)["uncertainty"]) == list(EVALUATED_KINDS)


@pytest.mark.drawn
def test_the_error_is_scored_as_an_uncertainty_and_as_a_probability(world):
    """Half of the points with an error of 1/2 are wrong, and none of those with 1/8."""
    world.add("000000", [CAR, CAR, CAR, 0], [CAR, ROAD, CAR, CAR])
    world.put("uncertainty/error", "000000", [0.5, 0.5, 0.125, 0.9])
    world.add("000001", [ROAD, ROAD], [ROAD, ROAD])
    world.put("uncertainty/error", "000001", [0.125, np.nan])
    evaluation = world.evaluate()
    error = evaluation.uncertainty.kinds["error"]
    assert (error.points, error.wrong, error.without_value) == (4, 1, 1)
    assert error.auroc == pytest.approx(5 / 6)
    assert error.ece == pytest.approx(2 * 0.125 / 4)
    report = report_of(world)
    assert report["uncertainty"]["error"]["ece"] == error.ece
    assert report["uncertainty"]["error"]["without_value"] == 1
    assert error.reliability.points.sum() == 4
    assert (world.out / "eval_error.png").exists()
    threshold = report["accepted"]
    assert (threshold["kind"], threshold["coverage"], threshold["risk"]) == ("error", 0.5, 0)
    assert threshold["sentence"] == evaluation.uncertainty.accepted.sentence
    assert 0.125 < threshold["threshold"] < 0.5
    assert (world.out / "eval_risk_coverage.png").exists()


@pytest.mark.parametrize(
    ("error", "wrong", "warning"),
    [
        ([0.9, 0.9, 0.1, 0.9], 2, "calibrated"),
        ([0.1, 0.1, 0.9, 0.1], 0, "ranks"),
        ([0.01, 0.01, 0.99, 0.01], 2, None),
    ],
)
def test_an_error_that_is_worse_than_the_softmax_is_warned_of(world, caplog, error, wrong, warning):
    world.add("000000", [ROAD if i == wrong else CAR for i in range(4)], [CAR] * 4)
    world.put("probabilities", "000000", softmax(*(0.6 if i == wrong else 0.9 for i in range(4))))
    world.put("uncertainty/error", "000000", error)
    world.evaluate()
    warnings = [message for message in caplog.messages if "the error" in message]
    assert any(warning in text for text in warnings) if warning else not warnings


@pytest.mark.parametrize(
    ("truth", "error", "entropy", "kind"),
    [
        ([CAR, ROAD], [0.1, 0.5], [0.5, 0.1], "error"),
        ([CAR, ROAD], [np.nan, np.nan], [0.5, 0.1], "entropy"),
        ([CAR, ROAD], [np.nan, np.nan], None, None),
        ([0, 0], [0.1, 0.5], [0.5, 0.1], None),
    ],
)
def test_threshold_is_of_the_error_else_of_the_entropy(world, truth, error, entropy, kind):
    world.add("000000", truth, [CAR, CAR])
    world.put("uncertainty/total", "000000", [0.1, 0.2])
    for name, values in (("error", error), ("entropy", entropy)):
        if values is not None:
            world.put(f"uncertainty/{name}", "000000", values)
    accepted = world.evaluate().uncertainty.accepted
    assert (accepted and accepted.kind) == kind
    assert (report_of(world)["accepted"] is not None) == (kind is not None)
