# SPDX-License-Identifier: MIT
"""Threshold above which labels are rejected, chosen so that a new scan has few wrong labels."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import LabelError, TrainingError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import predict_pixels, refine_labels
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts, AcceptedLabels
from salsanext_cli.core.measures.histograms import UNCERTAINTY_BINS, bin_of, highest_of_bins
from salsanext_cli.core.measures.population import traits_of_units
from salsanext_cli.core.measures.risk_control import (
    enough_drives,
    guarantee,
    held_thresholds,
    likely_thresholds,
    means_of_units,
    needed_drives,
)
from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.network.card import RiskThreshold, scan_digest
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.sensors.sensor import FittedView
from salsanext_cli.core.texts import first_few, percentage, with_hint
from salsanext_cli.core.uncertainty.error_features import error_probability, knows_error
from salsanext_cli.core.wording import argument
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.fit.sensor_fit import labels_depend_on
from salsanext_cli.runs.loop.job import Steps
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.selection import data_set_of
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, log_recorded
from salsanext_cli.training.tuning.consecutive import consecutive_warning
from salsanext_cli.training.tuning.risk_level import (
    FewUnits,
    RiskLevel,
    TooFewScansError,
    require_scans,
)
from salsanext_cli.training.tuning.scans import NOT_SCORED, Tuned, TuningScans

LEAST_COVERAGE = 0.25  # Share of accepted points below which a threshold is of little use
MAX_LISTED = 5  # Held-out sequences that are listed, the worst ones

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedScan:
    """Scored points of a scan, counted by the bin of their uncertainty."""

    file: ScanFile
    digest: str
    points: int
    # Accepted points, and accepted wrong ones, up to each bin, (2, B)
    below: npt.NDArray[np.int32]
    traits: UnitTraits | None  # Of all labels, also where the truth is not scored


@dataclass(frozen=True, slots=True)
class HeldOutSequence:
    """Points of a sequence below the threshold of the other sequences, shares 0…1.

    `accepted` and `loss` are mean shares of the points of a scan: accepted, and accepted and wrong;
    `worst` is the largest loss of a scan, `above` the share of scans above the level.
    """

    sequence: str
    scans: int
    accepted: float
    loss: float
    worst: float
    above: float

    def exceeds(self, level: RiskLevel) -> bool:
        """Return whether more labels are wrong than the level allows."""
        if level.confidence is None:
            return self.loss > level.at_most
        # 1 - 0.9 is less than 0.1 by the last digit.
        return self.above > round(1 - level.confidence, 9)


def judged_scan(
    prepared: PreparedFile, pixels: PixelPrediction, space: LabelSpace, counts: Counts
) -> JudgedScan:
    """Label a scan as `predict` does, and judge it: by the error if there is a softmax.

    Add its points to `counts` (C, C, B + 1) by truth, label and bin, the last one for no label.
    """
    file = prepared.file
    network = prepared.scan.network
    projected = prepared.scan.projected
    image = projected.image
    of_scan = refine_labels(prepared.scan, pixels, KnnParameters())
    labels = of_scan.labels
    truth = space.to_train(read_labels(file.label_path, len(labels)), source=file.label_path)
    scored = space.scored[truth]
    if not scored.any():
        raise LabelError(file.label_path, NOT_SCORED, f"labels of {space.name}")
    values = points_from_pixels(1 - pixels.confidence, image.pixel_of_point, np.nan)
    if pixels.softmax is not None:
        values = error_probability(network, image, pixels.softmax, labels)
    summary = ScanSummary.of_scan(file, of_scan, network.space)
    traits = summary.with_traits(of_scan, values).traits
    bins = np.where(np.isnan(values) | (labels == 0), UNCERTAINTY_BINS, bin_of(values))
    truth, labels, bins = truth[scored], labels[scored], bins[scored]
    np.add.at(counts, (truth, labels, bins), 1)
    both = bins, bins[labels != truth]
    of_bins = np.array([np.bincount(part, minlength=UNCERTAINTY_BINS + 1) for part in both])
    below = of_bins[:, :-1].cumsum(axis=1, dtype=np.int32)
    return JudgedScan(file, scan_digest(projected.scan), len(truth), below, traits)


def fit_risk(scans: TuningScans, at_most: float, confidence: float | None = None) -> Tuned:
    """Choose the highest threshold of error, else of least confidence, that keeps to a level.

    The unit is the drive if there are enough, else the scan. The report also has the accepted
    labels, and each sequence at the threshold of the others.
    """
    level = RiskLevel(at_most, confidence)
    require_scans(scans.source, len(scans.files), level)
    drives = len({file.sequence for file in scans.files})
    unit = "drive" if enough_drives(drives, at_most, confidence) else "scan"
    few = _few_units(scans.files, unit, level)
    network, space = scans.network, scans.space
    kind = _kind_of_threshold(scans)
    counts = np.zeros((space.class_count, space.class_count, UNCERTAINTY_BINS + 1), np.int64)
    judged = _judged_scans(scans, kind, counts)
    shares = np.array([scan.below / scan.points for scan in judged])
    sequences = np.array([scan.file.sequence for scan in judged])
    units = sequences if unit == "drive" else np.arange(len(judged))
    losses = means_of_units(shares[:, 1], units)
    bins = held_thresholds(losses, *level)
    if not bins or not shares[:, 0, bins - 1].any():
        raise _no_threshold(scans.source, kind, few, level)
    risk = RiskThreshold(
        kind=kind,
        threshold=min(float(highest_of_bins()[bins - 1]), 1.0),
        at_most=at_most,
        confidence=confidence,
        unit=unit,
        scans=len(judged),
        sequences=tuple(np.unique(sequences).tolist()),
        digests="".join(scan.digest for scan in judged),
        settings=labels_depend_on(scans.settings, scans.network),
        views=tuple(map(FittedView.of, network.sensor.members)),
        population=_population(judged, unit),
        data_set=(data_set_of(scans.files[0]) or scans.source).resolve().name,
    )
    others = _held_out(shares, sequences, units, level)
    confusion = _confusion_of_accepted(counts, bins)
    points = {scan.file.name: _accepted_points(scan, bins) for scan in judged}
    labels = AcceptedLabels.of_confusion(confusion, space, points)
    report = {
        "guarantee": guarantee(risk),
        **plain(risk),
        "accepted": plain(labels),
        "held_out": plain(others),
        "names": list(points),
        "of_scans": [[p.accepted / p.points, p.loss] for p in points.values()],
        "sentences": [*labels.sentences, *_sentences(others)],
        "few": None,
        "computed_by": _computed_by(network),
        "warnings": plain(_warnings(scans.files, unit, level)),
    }
    if few:
        report["few"] = _report_of_few(few, judged, losses, labels)
    elif labels.coverage < LEAST_COVERAGE:
        text = f"the threshold accepts only {percentage(labels.coverage)} of the points"
        hint = f"use a higher {argument('at_most')}, or scans of more drives"
        log.warning("%s", with_hint(text, hint))
    _warn_of_held_out(others, level, unit)
    return replace(network.card, risk=risk), report


def _judged_scans(scans: TuningScans, kind: str, counts: Counts) -> list[JudgedScan]:
    """Label and judge all scans by a kind of uncertainty; `counts` as of `judged_scan`."""
    network = scans.network

    def prepare(file: ScanFile) -> PreparedFile:
        return read_prepared(file, network)

    def predict(files: Sequence[PreparedFile]) -> list[PixelPrediction]:
        return predict_pixels(network, [file.scan for file in files], softmax=kind == "error")

    judge = partial(judged_scan, space=scans.space, counts=counts)
    steps = Steps(prepare, predict, judge)
    return [*scans.run(steps).values()]


def _accepted_points(scan: JudgedScan, bins: int) -> AcceptedCounts:
    """Return the points of a scan in the bins that are accepted."""
    accepted, wrong = scan.below[:, bins - 1].tolist()
    return AcceptedCounts(points=scan.points, accepted=accepted, wrong=wrong)


def _confusion_of_accepted(counts: Counts, bins: int) -> Counts:
    """Return the confusion matrix (C, C) of `counts` (C, C, B + 1), with rejected points as 0."""
    confusion: Counts = counts[..., :bins].sum(axis=2)
    confusion[:, 0] += counts[..., bins:].sum(axis=(1, 2))
    return confusion


def _population(judged: Sequence[JudgedScan], unit: str) -> tuple[UnitTraits, ...]:
    """Return the traits of each scan or drive."""
    traits = [scan.traits for scan in judged if scan.traits]
    if unit == "scan":
        return tuple(traits)
    return traits_of_units(traits, [scan.file.sequence for scan in judged])


def _no_threshold(source: Path, kind: str, few: FewUnits | None, level: RiskLevel) -> TrainingError:
    """Return the error about a level that every threshold exceeds."""
    limit = percentage(level.at_most, figures=3)
    problem = f"no threshold of {kind} accepts a point within {limit}"
    if few:
        return TooFewScansError(source, problem, hint=few.hint)
    hint = f"use a higher {argument('at_most')}, or better weights"
    return TrainingError(source, problem, hint=hint)


def _few_units(files: Sequence[ScanFile], unit: str, level: RiskLevel) -> FewUnits | None:
    """Return the scans or drives if they are few for a level, and warn of it."""
    units = {file.sequence for file in files} if unit == "drive" else {*files}
    few = FewUnits.among(len(units), unit, level)
    if few:
        few.warn_before()
    return few


def _report_of_few(
    few: FewUnits, judged: Sequence[JudgedScan], losses: Ratios, labels: AcceptedLabels
) -> dict[str, float]:
    """Estimate what more scans with equal losses would accept; warn, and return plain data."""
    bins = likely_thresholds(losses, *few.level, few.useful)
    accepted = sum(int(scan.below[0, bins - 1]) for scan in judged) if bins else 0
    by_useful = accepted / sum(scan.points for scan in judged)
    few.warn_after(labels.coverage, by_useful)
    return {"left": few.left, "useful": few.useful, "accepted_by_useful": by_useful}


def _computed_by(network: Network) -> dict[str, str]:
    """Return device, library and number type of the labels."""
    backend = network.backend
    return {"device": backend.device, "engine": backend.library, "precision": backend.precision}


def _warnings(files: Sequence[ScanFile], unit: str, level: RiskLevel) -> list[ScanWarning]:
    """Log and return reasons to doubt the guarantee of scans."""
    if unit == "drive":
        return []
    warning = consecutive_warning(files, needed_drives(*level))
    warnings = [warning] if warning else []
    log_recorded(warnings)
    return warnings


def _warn_of_held_out(others: Sequence[HeldOutSequence], level: RiskLevel, unit: str) -> None:
    """Warn of held-out sequences that exceed the level, or that there are none."""
    if (above := [part.sequence for part in others if part.exceeds(level)]) and unit == "scan":
        log.warning("%s: above the level with the threshold of the others", first_few(above))
    elif not others:
        log.warning("scans of one sequence do not show whether another one keeps to the level")


def _kind_of_threshold(scans: TuningScans) -> str:
    """Return the kind of uncertainty of the threshold; warn if it was fitted to these sequences."""
    card, files = scans.network.card, scans.files
    if not knows_error(scans.network):
        return "least_confidence"
    fitted = {*card.error.scores.get("sequences", ())} if card.error else set()
    if same := sorted(fitted & {file.sequence for file in files}):
        message = "the error was fitted to %s too: the guarantee needs scans that no fit has seen"
        log.warning(message, first_few(same))
    return "error"


def _sentences(others: Sequence[HeldOutSequence]) -> Iterator[str]:
    """Yield sentences about held-out sequences."""
    worst = sorted(others, key=lambda part: -part.loss)[:MAX_LISTED]
    for part in worst:
        wrong = f"{percentage(part.loss)} of all points accepted and wrong"
        accepted = f"{percentage(part.accepted)} accepted"
        of_worst = f", {percentage(part.worst)} in the worst scan" if part.scans > 1 else ""
        shares = f"{accepted}, {wrong}{of_worst}"
        yield f"{part.sequence} with the threshold chosen on the others: {shares}"
    if more := len(others) - len(worst):
        noun = "sequence" if more == 1 else "sequences"
        yield f"{more} more {noun} with a smaller share of wrong points"


def _held_out(
    shares: Ratios, sequences: npt.NDArray[np.str_], units: npt.NDArray[Any], level: RiskLevel
) -> list[HeldOutSequence]:
    """Return each sequence at the threshold of the others; nothing for a single sequence.

    `shares` (n, 2, B): points that are accepted, and accepted and wrong; `units`: as
    `means_of_units` takes them.
    """
    reports, names, count = [], np.unique(sequences), len(np.unique(units))
    for sequence in names if len(names) > 1 else ():
        part = sequences == sequence
        losses = means_of_units(shares[~part, 1], units[~part])
        bins = held_thresholds(losses, *level, scans=count)
        accepted, wrong = shares[part, :, bins - 1].T if bins else np.zeros((2, part.sum()))
        above = (wrong > level.at_most).mean()
        means = map(float, (accepted.mean(), wrong.mean(), wrong.max(), above))
        reports.append(HeldOutSequence(str(sequence), int(part.sum()), *means))
    return reports
