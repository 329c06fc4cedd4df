# SPDX-License-Identifier: MIT
"""Differences of two runs on the same scans, with paired intervals over the scans."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.files.json_files import plain
from salsanext_cli.measures.scores import Counts, Mask, Ratios, ious, largest_confusions, ratio
from salsanext_cli.results.paths import ScanFile

RESAMPLES, SEED = 1000, 0
MIN_SCANS = 5  # Fewer scans have no interval: their resamples are too much alike
MAX_LISTED = 10  # Scans, and pairs of classes


class Difference(NamedTuple):
    """Score of two runs, 0…1, and the 95 % interval of the difference; NaN if there is none."""

    before: float
    after: float
    difference: float
    low: float
    high: float


def paired_differences(sums: Counts, present: Mask, *, rejecting: bool = False) -> list[Difference]:
    """Return differences of accuracy, mean IoU of present classes, and IoUs; or coverage and risk.

    `sums`: (S, 2, 3, C), `class_sums` of S scans by both runs. Each resample (paired bootstrap)
    draws the same scans for both runs.
    """
    random, flat = np.random.default_rng(SEED), sums.reshape(len(sums), -1)
    totals = [flat.sum(axis=0)]
    for _ in range(RESAMPLES if len(sums) >= MIN_SCANS else 0):
        times_drawn = np.bincount(random.integers(len(sums), size=len(sums)), minlength=len(sums))
        totals.append(times_drawn @ flat)
    totals_of_runs = np.array(totals).reshape(-1, *sums.shape[1:])
    scores = _accepted_scores(totals_of_runs) if rejecting else _scores(totals_of_runs, present)
    difference = scores[:, 1] - scores[:, 0]
    bounds, resampled = np.full((2, difference.shape[1]), np.nan), difference[1:]
    # A class that a resample lacks has no difference there.
    known = ~np.isnan(resampled).all(axis=0)
    if known.any():
        bounds[:, known] = np.nanpercentile(resampled[:, known], (2.5, 97.5), axis=0)
    return [Difference(*row) for row in np.vstack([scores[0], difference[0], bounds]).T.tolist()]


def _scores(sums: Counts, present: Mask) -> Ratios:
    """Return accuracy, mean IoU and IoUs (R, 2, 2 + C) of class sums (R, 2, 3, C)."""
    of_classes, (hits, truths, _) = ious(sums), np.moveaxis(sums.sum(axis=-1), -1, 0)
    # The truth is the same for both runs, and so are the classes of the mean.
    known = present & (sums[:, :, 1] > 0)
    total = np.where(known, of_classes, 0).sum(axis=-1)
    mean = np.where(known.any(axis=-1), total / np.maximum(known.sum(axis=-1), 1), np.nan)
    return np.concatenate([ratio(hits, truths)[..., None], mean[..., None], of_classes], axis=-1)


def _accepted_scores(sums: Counts) -> Ratios:
    """Return coverage and risk (…, 2) of class sums (…, 3, C); class 0 means no label."""
    hits, points = sums[..., 0, 1:].sum(axis=-1), sums[..., 1, :].sum(axis=-1)
    labelled = points - sums[..., 2, 0]
    return np.stack([ratio(labelled, points), ratio(labelled - hits, labelled)], axis=-1)


class ScanPair(NamedTuple):
    """Comparison of the labels of one scan by two runs."""

    file: ScanFile
    turned: Counts  # (C, C): points by label of the first run and of the second
    sums: Counts | None = None  # (2, 3, C): class sums of both runs; None without truth
    trained_on: bool = False  # Whether the weights of a run were trained on it


def changed(turned: Counts) -> float:
    """Return the share of points with another label, of those labelled by either run."""
    points = int(turned.sum() - turned[0, 0])
    return 1 - int(turned.trace() - turned[0, 0]) / points if points else 0.0


@dataclass(frozen=True)
class RunComparison:
    """Comparison of two runs on the same scans."""

    space: LabelSpace  # Classes of both runs
    pairs: Sequence[ScanPair]  # At least one
    rejecting: bool = False  # Whether a run rejected labels, which are neither right nor wrong

    def difference(self, pair: ScanPair) -> float:
        """Return the difference of accuracy, or of risk, of a scan; NaN without truth."""
        if pair.sums is None:
            return math.nan
        of_scan = pair.sums[None]
        differences = paired_differences(of_scan, self.space.scored, rejecting=self.rejecting)
        return differences[self.rejecting].difference

    @cached_property
    def sums(self) -> Counts:
        """Class sums (S, 2, 3, C) of the scans with truth that no run was trained on."""
        known = [p.sums for p in self.pairs if p.sums is not None and not p.trained_on]
        return np.array(known) if known else np.zeros((0, 2, 3, self.space.class_count), int)

    @cached_property
    def scores(self) -> dict[str, Difference]:
        """Accuracy, mean IoU and IoU of the classes present, or coverage and risk, by name."""
        present = self.sums[:, 0, 1].sum(axis=0) > 0
        if not present.any():
            return {}
        if self.rejecting:
            differences = paired_differences(self.sums, present, rejecting=True)
            return dict(zip(("coverage", "risk"), differences, strict=True))
        accuracy, mean, *ious_of_classes = paired_differences(self.sums, present)
        named = zip(self.space.names, ious_of_classes, present, strict=True)
        of_classes = {name: iou for name, iou, is_present in named if is_present}
        return {"accuracy": accuracy, f"mean IoU, {present.sum()} classes": mean} | of_classes

    @cached_property
    def turned(self) -> Counts:
        """Points (C, C) of all scans by label of the first run and of the second."""
        return np.sum([pair.turned for pair in self.pairs], axis=0)

    def turns(self) -> list[tuple[str, str, int, float]]:
        """Return class before and after, points, and their share; most points first."""
        names = self.space.names
        return [
            (names[a], names[b], points, float(points / self.turned[a].sum()))
            for a, b, points in largest_confusions(self.turned, MAX_LISTED)
        ]

    def most_changed(self) -> list[ScanPair]:
        """Return the scans with the largest changes, largest first."""
        differing = (pair for pair in self.pairs if changed(pair.turned))
        return sorted(differing, key=lambda pair: (-changed(pair.turned), pair.file))[:MAX_LISTED]

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; null stands for NaN."""
        gain = "risk" if self.rejecting else "gain"
        data = {
            "label_space": self.space.name,
            "scans": len(self.pairs),
            "scored": len(self.sums),
            "trained_on": [pair.file.name for pair in self.pairs if pair.trained_on],
            "agreement": 1 - changed(self.turned),
            "turned": self.turns(),
            "scores": {name: score._asdict() for name, score in self.scores.items()},
            "changed_most": [
                {"scan": p.file.name, "changed": changed(p.turned), gain: self.difference(p)}
                for p in self.most_changed()
            ],
        }
        return dict(plain(data))
