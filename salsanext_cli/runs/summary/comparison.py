# SPDX-License-Identifier: MIT
"""Comparison of the results of scans with their labels, read from an output folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts
from salsanext_cli.core.measures.calibration import SCAN_BINS, reliability
from salsanext_cli.core.measures.counts import (
    BAND_NAMES,
    OF_ERROR,
    OF_SOFTMAX,
    SOFTMAX,
    ScanCounts,
    ScanScores,
    band_of_point,
)
from salsanext_cli.core.measures.histograms import (
    confidence_histogram,
    error_histogram,
    uncertainty_histogram,
)
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.network.card import is_among
from salsanext_cli.core.records import Float, Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import with_hint
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.npy import read_probabilities
from salsanext_cli.runs.records.digest_files import NO_SCANS, RecordedScans
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.results.scan_results import read_kind
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanComparison:
    """Settings of the comparison of results with labels."""

    out: Path  # Output folder
    space: LabelSpace  # Compared classes, and meaning of the predicted raw ids
    labels: LabelSpace  # Meaning of the raw ids of the truth
    merging: ClassMerging | None  # From the classes of the probabilities to those of `space`
    sensor: Sensor  # Sensor of the range images, and origin of the scans
    rejects: bool = False  # Whether the run rejected points
    trained_on: RecordedScans = NO_SCANS  # Scans that the weights were trained on
    chosen_on: RecordedScans = NO_SCANS  # Scans that the threshold was chosen on
    by_distance: bool = False  # Whether to count distance bands too
    # Names of the scans whose label files are pre-labels, which nobody has reviewed
    unreviewed: frozenset[str] = frozenset()

    @classmethod
    def from_results(
        cls,
        results: Provenance,
        space: LabelSpace,
        labels: LabelSpace,
        *,
        by_distance: bool = False,
    ) -> ScanComparison:
        """Return the settings that the records of an output folder imply."""
        return cls(
            out=results.root,
            space=space,
            labels=labels,
            merging=results.merging_into(space),
            sensor=results.sensor(),
            rejects=results.rejected_above() is not None,
            trained_on=results.trained_on(),
            chosen_on=results.scans_of_threshold(),
            by_distance=by_distance,
        )

    def warnings(self) -> Iterator[str]:
        """Yield what the comparison cannot check, in words, because a file of digests is gone."""
        kinds = {
            "the weights were trained on these scans": self.trained_on,
            "the threshold was chosen on these scans": self.chosen_on,
        }
        for question, recorded in kinds.items():
            if recorded.missing:
                headline = f"{recorded.missing}: is missing, so it is unknown whether {question}"
                yield with_hint(headline, recorded.hint)

    def has_truth(self, scan: ScanFile) -> bool:
        """Return whether a scan has labels to compare with."""
        return scan.name not in self.unreviewed and present(scan.label_path)

    def count(self, scan: ScanFile) -> ScanCounts:
        """Count one scan; a scan without predictions counts as missing.

        Scored points are also counted by their probabilities and uncertainties, if there are any.
        Rejected points count as misses and have no uncertainty.
        """
        space = self.space
        counts = ScanCounts.none(space, self.by_distance)
        predictions = output_path(self.out, scan.sequence, "predictions", scan.stem)
        if not present(predictions):
            counts.missing.append(scan.name)
            return counts
        cloud = read_scan(scan.path, self.sensor) if self.by_distance else None
        raw_truth, raw_predicted = _labels(scan, predictions, self.sensor, cloud)
        truth = self.labels.to_train(raw_truth, strict=False, source=scan.label_path)
        predicted = space.to_train(raw_predicted, strict=False, source=predictions)
        read = cache(lambda: cloud or read_scan(scan.path, self.sensor))
        counts.scans = 1
        counts.training_scans = int(is_among(self.trained_on.digests, len(truth), read))
        counts.unknown_truth.update(self.labels.unknown_ids(raw_truth))
        counts.unknown_predictions.update(space.unknown_ids(raw_predicted))
        counts.confusion = confusion_matrix(truth, predicted, space.class_count)
        counts.by_sequence[scan.sequence] = counts.confusion.copy()
        scan_scores = scores(counts.confusion, space)
        counts.by_scan[scan.name] = ScanScores(
            points=scan_scores.points,
            accuracy=scan_scores.accuracy,
            iou_mean_present=scan_scores.iou_mean_present,
        )
        if cloud is not None:
            sensor = sensor_of_result(self.out, scan, cloud, self.sensor)
            seen = in_sensor_frame(cloud, sensor)
            bands = band_of_point(seen.points)
            counts.bands = tuple(
                confusion_matrix(truth[bands == i], predicted[bands == i], space.class_count)
                for i in range(len(BAND_NAMES))
            )
        scored = space.scored[truth]
        wrong = predicted[scored] != truth[scored]
        values = self._count_softmax(scan, scored, truth[scored], counts)
        values |= self._uncertainties(scan, scored, counts)
        if self.rejects:
            labelled = predicted[scored] != 0
            counts.accepted[scan.name] = AcceptedCounts(
                points=len(labelled),
                accepted=int(labelled.sum()),
                wrong=int((labelled & wrong).sum()),
            )
            counts.threshold_scans = int(is_among(self.chosen_on.digests, len(scored), read))
            values = {kind: np.where(labelled, v, np.nan) for kind, v in values.items()}
        for kind, point_values in values.items():
            counts.histograms[kind] = uncertainty_histogram(point_values, wrong)
        if "error" in values:
            counts.histograms[OF_ERROR] = error_histogram(values["error"], wrong)
        return counts

    def _count_softmax(
        self, scan: ScanFile, scored: Mask, truth: TrainIds, counts: ScanCounts
    ) -> dict[str, Float]:
        """Count the probabilities of scored points, if any; return uncertainties from them."""
        path = output_path(self.out, scan.sequence, SOFTMAX, scan.stem)
        if not present(path):
            return {}
        counts.files[SOFTMAX] = 1
        softmax = read_softmax(path, scored, self.space, self.merging)
        histogram = confidence_histogram(softmax, truth)
        counts.histograms[SOFTMAX] = histogram
        if histogram.scans:
            counts.calibration_errors.append(reliability(histogram.counts, SCAN_BINS).error)
        return {kind: derive(softmax) for kind, derive in OF_SOFTMAX.items()}

    def _uncertainties(self, scan: ScanFile, scored: Mask, counts: ScanCounts) -> dict[str, Float]:
        """Read the uncertainties of scored points, by kind."""
        values = {}
        for kind in UNCERTAINTY:
            folder = f"uncertainty/{kind}"
            path = output_path(self.out, scan.sequence, folder, scan.stem)
            if not present(path):
                continue
            counts.files[folder] = 1
            # The files contain the confidence before classes are merged.
            if self.merging is None or kind not in OF_SOFTMAX or SOFTMAX not in counts.files:
                values[kind] = read_kind(path, kind, len(scored))[scored]
        return values


def read_softmax(
    path: Path, selected: Mask, space: LabelSpace, merging: ClassMerging | None
) -> npt.NDArray[Any]:
    """Read the probabilities of selected points, summed over merged classes; NaN for none."""
    count = space.class_count if merging is None else len(merging.targets)
    softmax = read_probabilities(path, len(selected), count)[selected]
    if not space.scored[0]:
        # `predict` marks points without a pixel by a probability of 1, which no softmax reaches.
        softmax[softmax[:, 0] == 1] = np.nan
    return softmax if merging is None else merging.add(softmax.T.astype(np.float32)).T


def _labels(
    scan: ScanFile, predictions: Path, sensor: Sensor, cloud: Scan | None
) -> tuple[RawIds, RawIds]:
    """Read truth and predictions; if their lengths differ, the scan shows which is wrong."""
    if cloud is None:
        raw_predicted = read_labels(predictions)
        try:
            return read_labels(scan.label_path, len(raw_predicted)), raw_predicted
        except LabelError:
            cloud = read_scan(scan.path, sensor)
    return read_labels(scan.label_path, len(cloud)), read_labels(predictions, len(cloud))
