# SPDX-License-Identifier: MIT
"""Threshold above which labels are rejected, chosen so that a new scan has few wrong ones."""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.backend import PixelPrediction
from salsanext_cli.errors import LabelError, TrainingError, UsageError, counted, first_few
from salsanext_cli.files.json_files import plain
from salsanext_cli.fitting.label_scan import PreparedScan, labelled, prepared_for
from salsanext_cli.fitting.sensor_fit import labels_depend_on
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.measures.histograms import UNCERTAINTY_BINS, bin_of, highest_of_bins
from salsanext_cli.measures.risk_control import (
    ACCEPTS_NONE,
    AcceptedLabels,
    enough_drives,
    guarantee,
    held_thresholds,
    means_of_units,
    needed_scans,
)
from salsanext_cli.measures.scores import Counts, Ratios
from salsanext_cli.network.card import RiskThreshold, scan_digest
from salsanext_cli.option_fields import KnnParameters
from salsanext_cli.parallel.job import Steps
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.sensors.sensor import FittedView
from salsanext_cli.training.tuning.scans import Tuned, TuningScans
from salsanext_cli.uncertainty.error_features import error_probability, knows_error

CURVE_POINTS = 101
MAX_LISTED = 5  # Held-out sequences that are listed, those with most wrong labels

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedScan:
    """Scored points of a scan, counted by the bin of their uncertainty."""

    file: ScanFile
    digest: str
    points: int
    # (2, C, B): points kept, and kept and wrong, up to each bin, by label; (2, 1, B): of all labels
    below: npt.NDArray[np.int32]


class RiskLevel(NamedTuple):
    """Level of risk that a threshold is to hold."""

    at_most: float  # Largest share of the points that may be kept and wrong, 0…1
    confidence: float | None  # Share of scans or drives that hold it; None: it holds for their mean


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Points of a sequence that the threshold of the other sequences keeps, shares 0…1."""

    sequence: str
    scans: int
    kept: float  # Mean share of the points of a scan that is kept
    loss: float  # Mean share that is kept and wrong, and the largest of a scan
    worst: float
    above: float  # Share of the scans with a larger share than the level

    def exceeds(self, level: RiskLevel) -> bool:
        """Return whether more is wrong than the level allows."""
        if level.confidence is None:
            return self.loss > level.at_most
        return self.above > 1 - level.confidence

    @property
    def sentence(self) -> str:
        """Sentence about the sequence."""
        shares = f"{self.kept:.1%} kept, {self.loss:.1%} of all points kept and wrong"
        by = "by the threshold of the others for all classes"
        return f"{self.sequence} {by}: {shares}, {self.worst:.1%} at worst"


def judged_scan(
    scan: PreparedScan,
    pixels: PixelPrediction,
    space: LabelSpace,
    counts: Counts,
    per_class: bool = False,
) -> JudgedScan:
    """Label a scan as `predict` does, and judge it: by the error if the softmax is there.

    `counts` (C, C, B + 1): its points are added by truth, label and bin, the last without a label.
    """
    file, image, network = scan.projected.file, scan.projected.image, scan.network
    labels = labelled(scan, pixels, KnnParameters()).labels
    truth = space.to_train(read_labels(file.label_path, len(labels)), source=file.label_path)
    scored = space.scored[truth]
    if not scored.any():
        expected = f"labels of {space.name}"
        raise LabelError(file.label_path, "no point is of a class that counts", expected)
    values = points_from_pixels(1 - pixels.confidence, image.pixel_of_point, np.nan)
    if pixels.softmax is not None:
        values = error_probability(network, image, pixels.softmax, labels)
    bins = np.where(np.isnan(values) | (labels == 0), UNCERTAINTY_BINS, bin_of(values))
    truth, labels, bins = truth[scored], labels[scored], bins[scored]
    np.add.at(counts, (truth, labels, bins), 1)
    shape = space.class_count if per_class else 1, UNCERTAINTY_BINS + 1
    place = (labels.astype(np.intp) if per_class else 0) * shape[1] + bins
    both = (place, place[labels != truth])
    of_bins = [np.bincount(each, minlength=math.prod(shape)) for each in both]
    below = np.reshape(of_bins, (2, *shape))[..., :-1].cumsum(axis=2, dtype=np.int32)
    return JudgedScan(file, scan_digest(scan.projected.scan), len(truth), below)


def kept_labels(
    scans: Sequence[JudgedScan], counts: Counts, space: LabelSpace, held: Counts
) -> tuple[AcceptedLabels, dict[str, tuple[int, ...]]]:
    """Return what is kept at the highest of so many thresholds that hold, of each label or of all.

    Then points, kept and wrong ones of each scan.
    """
    is_kept = np.arange(counts.shape[2]) < held[:, None]
    confusion = (counts * is_kept).sum(axis=2)
    confusion[:, 0] += (counts * ~is_kept).sum(axis=(1, 2))
    labels = np.flatnonzero(held)
    kept = [each.below[:, labels, held[labels] - 1].sum(axis=1).tolist() for each in scans]
    of_scans = {s.file.name: (s.points, *of_scan) for s, of_scan in zip(scans, kept, strict=True)}
    return AcceptedLabels.of_confusion(confusion, space, of_scans), of_scans


def fit_risk(
    scans: TuningScans, at_most: float, confidence: float | None = None, per_class: bool = False
) -> Tuned:
    """Choose the highest threshold of error, else of least confidence, that holds a level.

    The drive is the unit if there are enough of them, else the scan.
    `per_class`: hold the level of the points of each label, too, by a threshold of its own, if so
    many scans or drives have that label. Reports beside it `AcceptedLabels`, and what the threshold
    of the other sequences keeps of each.
    """
    level = RiskLevel(at_most, confidence)
    _require_scans(scans, level)
    network, space = scans.network, scans.space
    kind = _kind_of_threshold(scans)
    counts = np.zeros((space.class_count, space.class_count, UNCERTAINTY_BINS + 1), np.int64)
    judged = _judged(scans, kind, counts, per_class)
    shares = np.array([scan.below.sum(axis=1) / scan.points for scan in judged])
    sequences = np.array([scan.file.sequence for scan in judged])
    unit, units = "scan", np.arange(len(judged))
    if enough_drives(len(np.unique(sequences)), at_most, confidence):
        unit, units = "drive", sequences
    held = held_thresholds(means_of_units(shares[:, 1], units), at_most, confidence)
    if not held or not shares[:, 0, held - 1].any():
        found = f"no threshold of {kind} keeps points and at most {at_most:.3g} of them wrong"
        raise TrainingError(scans.source, found, "a higher --at-most, or better weights")
    of_labels, own = _of_labels(judged, units, held, level)
    # Of none, the last.
    highest = np.append(np.minimum(highest_of_bins(), 1.0), ACCEPTS_NONE)
    of_class = zip(space.names, highest[of_labels - 1].tolist(), strict=True)
    risk = RiskThreshold(
        kind=kind,
        threshold=float(highest[held - 1]),
        at_most=at_most,
        confidence=confidence,
        unit=unit,
        scans=len(judged),
        sequences=tuple(np.unique(sequences).tolist()),
        digests="".join(scan.digest for scan in judged),
        settings=labels_depend_on(scans.settings, scans.loaded),
        view=FittedView.of(network.sensor),
        other_views=tuple(map(FittedView.of, network.sensor.others)),
        classes={n: value for i, (n, value) in enumerate(of_class) if own[i]} if per_class else {},
    )
    left_out = _left_out(shares, sequences, units, level)
    labels, of_scans = kept_labels(judged, counts, space, of_labels)
    few = [space.names[i] for i in np.flatnonzero(counts.any(axis=(0, 2)) & ~own) if i]
    report = {
        "promise": guarantee(risk),
        **{name: value for name, value in plain(risk).items() if name != "classes" or per_class},
        "kept": plain(labels),
        "left_out": plain(left_out),
        "risk_coverage": _curve(shares).tolist(),
        "of_scans": [[kept / points, wrong / points] for points, kept, wrong in of_scans.values()],
        "sentences": [*labels.sentences, *_sentences(left_out, few if per_class else (), unit)],
    }
    if (above := [each.sequence for each in left_out if each.exceeds(level)]) and unit == "scan":
        log.warning("%s: more wrong than that, by the threshold of the others", first_few(above))
    elif not left_out:
        log.warning("scans of one sequence do not tell how the threshold holds on another")
    return replace(network.card, risk=risk), report


def _judged(scans: TuningScans, kind: str, counts: Counts, per_class: bool) -> list[JudgedScan]:
    """Label and judge all scans, as `judged_scan` does."""
    network = scans.network
    judge = partial(judged_scan, space=scans.space, counts=counts, per_class=per_class)

    def predict(some: Sequence[PreparedScan]) -> list[PixelPrediction]:
        return network.predict([scan.input for scan in some], softmax=kind == "error")

    return [*scans.run(Steps(partial(prepared_for, network), predict, judge))]


def _kind_of_threshold(scans: TuningScans) -> str:
    """Return the kind of uncertainty that the threshold is of; warn of a fit to these scans."""
    network = scans.network
    kind = "error" if knows_error(network) else "least_confidence"
    # The error may have been fitted to sequences of the same names.
    fitted = set(network.card.error.scores.get("sequences", ())) if network.card.error else set()
    if kind == "error" and (same := sorted(fitted & {file.sequence for file in scans.files})):
        message = "the error was fitted to %s too: a threshold holds for scans that no fit has seen"
        log.warning(message, first_few(same))
    return kind


def _curve(shares: Ratios) -> Ratios:
    """Return `CURVE_POINTS` of mean coverage and risk (2, P) of shares (n, 2, B)."""
    means = shares.mean(axis=0)
    wanted = np.linspace(0, means[0, -1], CURVE_POINTS)
    steps = np.unique(np.searchsorted(means[0], wanted).clip(max=UNCERTAINTY_BINS - 1))
    return means[:, steps]


def _sentences(left_out: Sequence[LeftOut], few: Sequence[str], unit: str) -> Iterator[str]:
    """Yield sentences about held-out sequences, and about classes of too few scans or drives."""
    worst = sorted(left_out, key=lambda each: -each.loss)[:MAX_LISTED]
    yield from (each.sentence for each in worst)
    if more := len(left_out) - len(worst):
        yield f"{counted(more, 'sequence')} more with less of them wrong"
    if few:
        yield f"{first_few(few)}: too few {unit}s for a promise, so by the common threshold"


def _of_labels(
    scans: Sequence[JudgedScan], units: npt.NDArray[Any], held: int, level: RiskLevel
) -> tuple[Counts, npt.NDArray[np.bool_]]:
    """Return how many thresholds hold for the points of each label, up to those held by all.

    Then which labels enough scans or drives have to hold a level, (C,); the others have all.
    """
    count = scans[0].below.shape[1]
    of_labels, own = np.full(count, held), np.zeros(count, np.bool_)
    for label in range(1, count):
        below = np.array([scan.below[:, label] for scan in scans])
        has = below[:, 0, -1] > 0
        own[label] = len(np.unique(units[has])) >= needed_scans(*level)
        if own[label]:
            losses = means_of_units(below[has, 1] / below[has, :1, -1], units[has])
            of_labels[label] = min(held, held_thresholds(losses, *level))
    return of_labels, own


def _require_scans(scans: TuningScans, level: RiskLevel) -> None:
    """Refuse what so many scans cannot promise; say what they can, and how many are missing."""
    at_most, confidence = level
    if not 0 < at_most < 1:
        raise UsageError("--at-most", f"{at_most:.4g}", "above 0 and below 100%, such as 5%")
    if confidence is not None and not 0.5 <= confidence < 1:
        raise UsageError("--confidence", f"{confidence:.4g}", "from 50% to below 100%")
    count = len(scans.files)
    missing = needed_scans(at_most, confidence) - count
    if missing <= 0:
        return
    if confidence is None:
        least = math.ceil(1000 / (count + 1)) / 10
        found, can = f"no less than {least:g} %", f"--at-most {least:g}%"
    else:
        exceed = 1 - (1 - confidence) ** (1 / max(count, 1))  # Clopper and Pearson's bound
        found = f"with {100 * confidence:.4g} % confidence no less than {exceed:.0%} of scans above"
        can = "a lower --confidence"
    promised = f"{counted(count, 'scan')} can promise {found}"
    raise TrainingError(
        scans.source, promised, f"{missing} more", f"add scans of other drives, or {can}"
    )


def _left_out(
    kept: Ratios, sequences: npt.NDArray[np.str_], units: npt.NDArray[Any], level: RiskLevel
) -> list[LeftOut]:
    """Return what is kept of each sequence by the threshold of the others; none of a single one.

    `kept` (n, 2, B): shares of the points that are kept, and kept and wrong; `units`: as
    `means_of_units` takes them.
    """
    reports, names, count = [], np.unique(sequences), len(np.unique(units))
    for sequence in names if len(names) > 1 else ():
        own = sequences == sequence
        others = means_of_units(kept[~own, 1], units[~own])
        held = held_thresholds(others, *level, scans=count)
        shares, losses = kept[own, :, held - 1].T if held else np.zeros((2, own.sum()))
        above = (losses > level.at_most).mean()
        means = map(float, (shares.mean(), losses.mean(), losses.max(), above))
        reports.append(LeftOut(str(sequence), int(own.sum()), *means))
    return reports
