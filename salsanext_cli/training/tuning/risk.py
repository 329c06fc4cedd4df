# SPDX-License-Identifier: MIT
"""Threshold above which labels are rejected, chosen so that a new scan has few wrong ones."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import LabelError, TrainingError, UsageError, counted, first_few
from salsanext_cli.fitting.label_scan import labelled, project_for
from salsanext_cli.fitting.scan_fit import labels_depend_on
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.measures.histograms import UNCERTAINTY_BINS, bin_of, highest_of_bins
from salsanext_cli.measures.risk_control import (
    KeptLabels,
    bad_share,
    held_thresholds,
    needed_scans,
    promise,
)
from salsanext_cli.measures.scores import Confusion, Counts, Ratios
from salsanext_cli.network.card import scan_digest
from salsanext_cli.options import KnnParameters
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.training.tuning.scans import Tuned, TuningScans
from salsanext_cli.uncertainty.error_features import knows_error, label_error

CURVE_POINTS = 101

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedScan:
    """Scored points of a scan, counted by the bin of their uncertainty."""

    file: ScanFile
    points: int
    below: npt.NDArray[np.int32]  # (2, B): points kept, and kept and wrong, up to each bin


def judged_scan(
    file: ScanFile, network: Network, space: LabelSpace, kind: str, counts: Counts
) -> JudgedScan | None:
    """Label a scan as `predict` does, and judge it; None if the weights were trained on it.

    `counts` (C, C, B + 1): its points are added by truth, label and bin, the last without a label.
    """
    projected = project_for(network, file)
    if scan_digest(projected.scan) in network.card.trained_on:
        return None
    image, softmax = projected.image, network.probabilities(projected.image, file.path)
    labels = labelled(projected, softmax, network, KnnParameters()).labels
    truth = space.to_train(read_labels(file.label_path, len(labels)), source=file.label_path)
    scored = space.scored[truth]
    if not scored.any():
        expected = f"labels of {space.name}"
        raise LabelError(file.label_path, "no point is of a class that counts", expected)
    values = points_from_pixels(1 - softmax.max(axis=0), image.pixel_of_point, np.nan)
    if kind == "error":
        values = label_error(network, image, softmax, labels)
    bins = np.where(np.isnan(values) | (labels == 0), UNCERTAINTY_BINS, bin_of(values))
    truth, labels, bins = truth[scored], labels[scored], bins[scored]
    np.add.at(counts, (truth, labels, bins), 1)
    of_bins = [np.bincount(b, minlength=UNCERTAINTY_BINS) for b in (bins, bins[labels != truth])]
    below = np.stack([each[:UNCERTAINTY_BINS] for each in of_bins]).cumsum(axis=1, dtype=np.int32)
    return JudgedScan(file, len(truth), below)


def kept_labels(
    scans: Sequence[JudgedScan], counts: Counts, space: LabelSpace, held: int
) -> KeptLabels:
    """Return what is kept at the highest of so many thresholds that hold."""
    confusion = Confusion(space.class_count, counts[..., :held].sum(axis=2))
    confusion.matrix[:, 0] += counts[..., held:].sum(axis=(1, 2))
    of_scans = {s.file.name: (s.points, *s.below[:, held - 1].tolist()) for s in scans}
    return KeptLabels.of_confusion(confusion, space, of_scans)


def fit_risk(scans: TuningScans, at_most: float, confidence: float | None = None) -> Tuned:
    """Choose the highest threshold of error, else of least confidence, that holds a level.

    Reports beside it `KeptLabels`, and what the threshold of the other sequences keeps of each.
    """
    if not 0 < at_most < 1:
        raise UsageError("--at-most", f"{at_most:.4g}", "above 0 and below 100%, such as 5%")
    if confidence is not None and not 0.5 <= confidence < 1:
        raise UsageError("--confidence", f"{confidence:.4g}", "from 50% to below 100%")
    _require_scans(scans, len(scans.files), at_most, confidence)
    network, space = scans.network, scans.space
    kind = "error" if knows_error(network) else "least_confidence"
    if kind == "error":
        _warn_of_fitted(scans)
    classes = space.class_count
    counts = np.zeros((classes, classes, UNCERTAINTY_BINS + 1), np.int64)
    every = [judged_scan(file, network, space, kind, counts) for file in scans.each()]
    judged = [scan for scan in every if scan]
    if trained_on := len(every) - len(judged):
        log.warning("%s left out: the weights were trained on them", counted(trained_on, "scan"))
        _require_scans(scans, len(judged), at_most, confidence)
    shares = np.empty((len(judged), 2, UNCERTAINTY_BINS))
    for share, scan in zip(shares, judged, strict=True):
        np.divide(scan.below, scan.points, out=share)
    numbers: dict[str, Any] = {"at_most": at_most, "confidence": confidence}
    held = held_thresholds(shares[:, 1], **numbers)
    if not held or not shares[:, 0, held - 1].any():
        found = f"no threshold of {kind} keeps points and at most {at_most:.3g} of them wrong"
        raise TrainingError(scans.source, found, "a higher --at-most, or better weights")
    labels = kept_labels(judged, counts, space, held)
    sequences = np.array([scan.file.sequence for scan in judged])
    left_out = _left_out(shares, sequences, numbers)
    risk = {
        "kind": kind,
        "threshold": float(min(highest_of_bins()[held - 1], 1.0)),
        **numbers,
        "scans": len(judged),
        "sequences": np.unique(sequences).tolist(),
        "settings": labels_depend_on(scans.settings, scans.loaded),
    }
    report = {
        "promise": promise(risk),
        **risk,
        "trained_on": trained_on,
        "kept": asdict(labels),
        "left_out": left_out,
        "risk_coverage": _curve(shares.mean(axis=0)),
        "of_scans": shares[:, :, held - 1].tolist(),
        "sentences": [*labels.sentences, *map(_sentence, left_out)],
    }
    if above := [each["sequence"] for each in left_out if exceeds(each, **numbers)]:
        log.warning("%s: more wrong than that, by the threshold of the others", first_few(above))
    elif not left_out:
        log.warning("scans of one sequence do not tell how the threshold holds on another")
    return Tuned(replace(network.card, risk=risk), report)


def _curve(means: Ratios) -> list[list[float]]:
    """Return what is kept, and kept and wrong, at about `CURVE_POINTS` of all thresholds (2, B)."""
    wanted = np.linspace(0, means[0, -1], CURVE_POINTS)
    steps = np.unique(np.searchsorted(means[0], wanted).clip(max=means.shape[1] - 1))
    points: list[list[float]] = means[:, steps].tolist()
    return points


def _warn_of_fitted(scans: TuningScans) -> None:
    """Warn where the error of the weights was fitted to sequences of the same names."""
    model = scans.network.card.error
    fitted = set(model.scores.get("sequences", ())) if model else set()
    if same := sorted(fitted & {file.sequence for file in scans.files}):
        message = "the error was fitted to %s too: a threshold holds for scans that no fit has seen"
        log.warning(message, first_few(same))


def _require_scans(
    scans: TuningScans, count: int, at_most: float, confidence: float | None
) -> None:
    """Refuse what so many scans cannot promise; say what they can, and how many are missing."""
    missing = needed_scans(at_most, confidence) - count
    if missing <= 0:
        return
    if confidence is None:
        least = math.ceil(1000 / (count + 1)) / 10
        found, can = f"no less than {least:g} %", f"--at-most {least:g}%"
    else:
        exceed = bad_share(0, max(count, 1), confidence)
        found = f"with {100 * confidence:.4g} % confidence no less than {exceed:.0%} of scans above"
        can = "a lower --confidence"
    promised = f"{counted(count, 'scan')} can promise {found}"
    raise TrainingError(
        scans.source, promised, f"{missing} more", f"add scans of other drives, or {can}"
    )


def _left_out(
    kept: Ratios, sequences: npt.NDArray[np.str_], numbers: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return what is kept of each sequence by the threshold of the others; none of a single one.

    `kept` (n, 2, B): shares of the points that are kept, and kept and wrong.
    """
    reports, names = [], np.unique(sequences)
    for sequence in names if len(names) > 1 else ():
        own = sequences == sequence
        held = held_thresholds(kept[~own, 1], **numbers, scans=len(kept))
        shares, losses = kept[own, :, held - 1].T if held else np.zeros((2, own.sum()))
        means = {"kept": shares.mean(), "loss": losses.mean(), "worst": losses.max()}
        means["above"] = (losses > numbers["at_most"]).mean()
        means = {name: float(value) for name, value in means.items()}
        reports.append({"sequence": str(sequence), "scans": int(own.sum()), **means})
    return reports


def exceeds(left_out: Mapping[str, Any], at_most: float, confidence: float | None) -> bool:
    """Say whether a sequence that was left out has more than is promised."""
    if confidence is None:
        return bool(left_out["loss"] > at_most)
    return bool(left_out["above"] > 1 - confidence)


def _sentence(each: Mapping[str, Any]) -> str:
    shares = f"{each['kept']:.1%} kept, {each['loss']:.1%} of all points kept and wrong"
    return (
        f"{each['sequence']} by the threshold of the others: {shares}, {each['worst']:.1%} at worst"
    )
