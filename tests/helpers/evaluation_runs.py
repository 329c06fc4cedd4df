# SPDX-License-Identifier: MIT
"""A data set and an output folder to evaluate, and results of evaluations."""

from pathlib import Path

import numpy as np
from scans import SMALL, write_array, write_bin

from salsanext_cli import LabelSpace, Scan, label_space, write_labels
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.core.measures.calibration import SCAN_BINS, CalibrationScores, reliability
from salsanext_cli.core.measures.counts import SOFTMAX, ScanCounts
from salsanext_cli.core.measures.histograms import confidence_histogram, uncertainty_histogram
from salsanext_cli.core.measures.uncertainty_evaluation import RankingScores, UncertaintyEvaluation
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import MissingResults
from salsanext_cli.runs.summary.comparison import ScanComparison

SPACE = label_space()
CAR, ROAD, MOVING_CAR, UNKNOWN = 10, 40, 252, 77


def small_space(*names: str) -> LabelSpace:
    """Return a label space of classes whose raw ids are train ids; the first one is ignored."""
    same = {i: i for i in range(len(names))}
    maps = {"learning_map": same, "learning_map_inv": same}
    return LabelSpace.from_dict({"name": "small", "labels": dict(enumerate(names)), **maps})


class World:
    """A data set and an output folder that tests fill scan by scan."""

    def __init__(self, folder: Path) -> None:
        self.dataset, self.out = folder / "Daten 1", folder / "öut"

    def add(self, stem, truth, predicted, sequence="08", distance=5.0):
        """Write a scan on a circle; None writes no file."""
        folder = self.dataset / "sequences" / sequence
        count = len(truth if truth is not None else predicted)
        angle = np.linspace(0, 6, count)
        points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) * distance
        scan = Scan(points.astype(np.float32), np.zeros(count, np.float32))
        write_bin(folder / "velodyne" / f"{stem}.bin", scan)
        if truth is not None:
            write_labels(folder / "labels" / f"{stem}.label", np.array(truth, np.uint32))
        if predicted is not None:
            path = output_path(self.out, sequence, "predictions", stem)
            write_labels(path, np.array(predicted, np.uint32))

    def evaluate(self, *, by_distance=False, **options):
        scans = find_scans(self.dataset)
        return evaluate_scans(
            scans, self.out, SPACE, RunOptions(**options), by_distance=by_distance
        )

    def put(self, folder, stem, values, dtype=None, sequence="08"):
        """Write probabilities or one kind of uncertainty of a scan in its usual dtype."""
        dtype = dtype or (np.float16 if folder == "probabilities" else np.float32)
        write_array(output_path(self.out, sequence, folder, stem), np.asarray(values, dtype))


def calibration_result(truth) -> CalibrationScores:
    """Return the calibration of points with 75 % of class 1 and 25 % of class 2."""
    rows = np.zeros((len(truth), SPACE.class_count), np.float16)
    rows[:, 1], rows[:, 2] = 0.75, 0.25
    histogram = confidence_histogram(rows, np.array(truth, int))
    counts = ScanCounts.none(SPACE)
    counts.histograms[SOFTMAX] = histogram
    if len(truth):
        counts.calibration_errors.append(reliability(histogram.counts, SCAN_BINS).error)
    return UncertaintyEvaluation.from_counts(counts).calibration


def run_of(out=Path(), rows=(), space=SPACE) -> RunResults:
    """Return the results of a run whose scans have no labels."""
    reader = ScanComparison(out=out, space=space, labels=space, merging=None, sensor=SMALL)
    return RunResults(reader, rows, None, MissingResults())


def ranking_result(uncertainty, wrong) -> RankingScores:
    """Return the scores of an uncertainty as a detector of wrong points."""
    counts, values = ScanCounts.none(SPACE), np.array(uncertainty, np.float32)
    counts.histograms["epistemic"] = uncertainty_histogram(values, np.array(wrong, bool))
    return UncertaintyEvaluation.from_counts(counts).kinds["epistemic"]
