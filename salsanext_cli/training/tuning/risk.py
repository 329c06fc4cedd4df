# SPDX-License-Identifier: MIT
"""Threshold above which labels are rejected, chosen so that a new scan has few wrong ones."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import LabelError, TrainingError, UsageError, counted, first_few
from salsanext_cli.fitting.label_scan import labelled, project_for
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.measures.histograms import highest_of_bins, uncertainty_histogram
from salsanext_cli.measures.risk_control import (
    KeptLabels,
    bad_share,
    held_thresholds,
    is_people,
    needed_scans,
    possible_level,
    promise,
)
from salsanext_cli.measures.scores import Counts, Ratios
from salsanext_cli.network.card import scan_digest
from salsanext_cli.options import KnnParameters
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.training.tuning.scans import Tuned, TuningScans
from salsanext_cli.uncertainty.error_features import knows_error, label_error, least_confidence

log = logging.getLogger(__name__)


@dataclass(slots=True, eq=False)
class JudgedScans:
    """Counts of the scored points of scans, by the bin of their uncertainty, one of B."""

    files: list[ScanFile] = field(default_factory=list)
    points: list[int] = field(default_factory=list)  # Of each scan, labelled or not
    # (2, B) of each scan: kept points and wrong ones of them, at the upper end of each bin
    kept: list[Counts] = field(default_factory=list)
    of_classes: Any = 0  # (2, C, B), over all scans: right and wrong points by label
    people: int = 0  # Number of points of people, and (B,) of those with another label
    missed: Any = 0
    trained_on: int = 0  # Number of scans left out since the weights were trained on them

    def add(self, file: ScanFile, network: Network, space: LabelSpace, kind: str) -> None:
        """Label a scan as `predict` does and judge its points."""
        projected = project_for(network, file)
        if scan_digest(projected.scan) in network.card.trained_on:
            self.trained_on += 1
            return
        softmax = network.probabilities(projected.image, file.path)
        labels = labelled(projected, softmax, network, KnnParameters()).labels
        truth = space.to_train(read_labels(file.label_path, len(labels)), source=file.label_path)
        image, scored = projected.image, space.scored[truth]
        if not scored.any():
            raise LabelError(file.label_path, "no point is of a class that counts")
        values = (
            label_error(network, image, softmax, labels)
            if kind == "error"
            else least_confidence(image, softmax)
        )
        values = np.where(labels == 0, np.nan, values)[scored]
        truth, labels = truth[scored], labels[scored]
        counts = uncertainty_histogram(values, labels != truth, labels, space.class_count).counts
        right, wrong = counts.sum(axis=1).cumsum(axis=1)
        people = is_people(space)
        of_people, others = people[truth], np.zeros(len(truth), np.intp)
        missed = uncertainty_histogram(values, of_people & ~people[labels], others, 1)
        self.files.append(file)
        self.points.append(len(truth))
        self.kept.append(np.stack([right + wrong, wrong]))
        self.of_classes = self.of_classes + counts
        self.people += int(of_people.sum())
        self.missed = self.missed + missed.counts[1, 0]

    def at(self, held: int, space: LabelSpace) -> KeptLabels:
        """Return what is kept at the highest of so many thresholds that hold."""
        right, wrong = self.of_classes[:, 1:, :held].sum(axis=2)
        missed = int(self.missed[:held].sum())
        scans = zip(self.files, self.kept, strict=True)
        by_name = {file.name: tuple(kept[:, held - 1].tolist()) for file, kept in scans}
        counts = sum(self.points), self.people, missed, right + wrong, wrong
        return KeptLabels.of_classes(*counts, space=space, scans=by_name)


def require_level(network: Network, at_most: float, confidence: float | None = None) -> None:
    """Raise what `fit_risk` raises for its numbers, before a scan is read."""
    if not 0 < at_most < 1:
        raise UsageError("--at-most", f"{at_most:.4g}", "above 0 and below 100%, such as 5%")
    if confidence is not None and not 0.5 <= confidence < 1:
        raise UsageError("--confidence", f"{confidence:.4g}", "from 50% to below 100%")


def fit_risk(scans: TuningScans, at_most: float, confidence: float | None = None) -> Tuned:
    """Choose the highest threshold of error, else of least confidence, that holds a level.

    Reports beside it the counts of `KeptLabels`, and under `left_out` what is kept of each sequence
    by a threshold chosen from the others, the same way.
    """
    network, space = scans.network, scans.space
    _require_scans(scans, len(scans.files), at_most, confidence)
    kind = "error" if knows_error(network) else "least_confidence"
    judged = JudgedScans()
    for file in scans.each():
        judged.add(file, network, space, kind)
    if judged.trained_on:
        log.warning("%s left out: the weights were trained on them", judged.trained_on)
        _require_scans(scans, len(judged.files), at_most, confidence)
    kept = np.stack(judged.kept) / np.array(judged.points)[:, None, None]
    numbers: dict[str, Any] = {"at_most": at_most, "confidence": confidence}
    held = held_thresholds(kept[:, 1], **numbers)
    if not held or not kept[:, 0, held - 1].any():
        found = f"no threshold of {kind} keeps points and at most {at_most:.3g} of them wrong"
        raise TrainingError(scans.source, found, "a higher --at-most, or better weights")
    labels = judged.at(held, space)
    sequences = [file.sequence for file in judged.files]
    left_out = _left_out(kept, judged.files, numbers)
    risk = {
        "kind": kind,
        "threshold": float(min(highest_of_bins()[held - 1], 1.0)),
        **numbers,
        "scans": len(judged.files),
        "sequences": sorted(set(sequences)),
    }
    report = {
        "promise": promise(risk),
        **risk,
        "trained_on": judged.trained_on,
        "losing": int((kept[:, 1, held - 1] > at_most).sum()),
        "kept": labels.to_dict(),
        "left_out": left_out,
        "sentences": list(labels.sentences),
    }
    above = [each["sequence"] for each in left_out if each["loss"] > at_most]
    if above:
        found = f"chosen from the others, it loses more than {at_most:.3g} on {first_few(above)}"
        log.warning("%s: the promise is for scans like all of these, not for other drives", found)
    elif not left_out:
        log.warning("scans of one sequence do not tell how the threshold holds on another")
    return Tuned(replace(network.card, risk=risk), report)


def _require_scans(
    scans: TuningScans, count: int, at_most: float, confidence: float | None
) -> None:
    """Refuse what so many scans cannot promise; say what they can, and how many are missing."""
    missing = needed_scans(at_most, confidence) - count
    if missing <= 0:
        return
    possible = possible_level(count, confidence)
    if confidence is None:
        can, found = f"--at-most {_up(possible)}", f"no less than {possible:.1%} for a new scan"
    else:
        exceed = f"at most {bad_share(0, count, confidence):.0%} of scans are above"
        can = f"--confidence {math.floor(100 * possible)}%"
        found = f"with a confidence of {confidence:.0%} at best that {exceed}"
    promised = f"{counted(count, 'scan')} can promise {found}"
    expected = f"{missing} more for {at_most:.3g}"
    raise TrainingError(scans.source, promised, expected, f"add scans, or {can}")


def _left_out(
    kept: Ratios, files: Sequence[ScanFile], numbers: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return what is kept of each sequence by the threshold of the others; none of a single one.

    `kept` (n, 2, B): shares of the points that are kept, and kept and wrong.
    """
    sequences = np.array([file.sequence for file in files])
    found = []
    for sequence in np.unique(sequences) if len(set(sequences)) > 1 else ():
        own = sequences == sequence
        held = held_thresholds(kept[~own, 1], **numbers, scans=len(files))
        shares, losses = kept[own, :, held - 1].T if held else np.zeros((2, own.sum()))
        found.append(
            {
                "sequence": str(sequence),
                "scans": int(own.sum()),
                "kept": float(shares.mean()),
                "loss": float(losses.mean()),
                "worst": float(losses.max()),
            }
        )
    return found


def _up(level: float) -> str:
    """Return a share as percent, rounded up to one digit."""
    return f"{math.ceil(1000 * level - 1e-9) / 10:g}%"
