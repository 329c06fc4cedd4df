# SPDX-License-Identifier: MIT
"""Numbers of points of a run, and shares of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.runs.summary.scan_summary import ScanSummary

CLASSES_SHOWN = 5  # Classes that a summary names


@dataclass(slots=True, kw_only=True)
class RunCounts:
    """Numbers of the points of a run, added scan by scan."""

    class_points: Counts | None = None  # (C,): number of points by predicted train id
    # Number of points that had a label when those above a threshold were rejected
    judged_points: int = 0
    rejected_points: int = 0  # Number of points rejected by their error
    unmeasured_points: int = 0  # Number of points without a measurement
    checked_points: int = 0  # Number of points of the scans that were projected
    ego_points: int = 0  # Number of these on the housing of the sensor or its vehicle
    # Mean of the largest probabilities of the points, 0…1, by name of the scan
    confidences: dict[str, float] = field(default_factory=dict)

    def add(self, scan: ScanSummary) -> None:
        """Add the points of a scan."""
        self.judged_points += scan.judged_points
        self.rejected_points += scan.rejected_points
        self.unmeasured_points += scan.unmeasured_points
        self.checked_points += scan.check.points
        self.ego_points += scan.check.ego_points
        if not math.isnan(scan.confidence):
            self.confidences[scan.file.name] = scan.confidence
        if scan.class_points is not None:
            before = 0 if self.class_points is None else self.class_points
            self.class_points = before + scan.class_points

    @property
    def ego_share(self) -> float:
        """Share of the points, 0…1, on the housing and the vehicle, over the scans of this run."""
        return self.ego_points / max(self.checked_points, 1)

    @property
    def unlabelled_share(self) -> float:
        """Share of the points, 0…1, without a label; `ego_share` if no scan is labelled."""
        points = self.class_points
        return self.ego_share if points is None else float(points[0] / max(points.sum(), 1))

    @property
    def unmeasured_share(self) -> float:
        """Share of the points, 0…1, without a measurement."""
        return self._share(self.unmeasured_points)

    @property
    def rejected_share(self) -> float:
        """Share of the points with a label, 0…1, that were rejected."""
        return self.rejected_points / max(self.judged_points, 1)

    @property
    def rejected_share_of_all(self) -> float:
        """Share of all points, 0…1, that were rejected."""
        return self._share(self.rejected_points)

    def _share(self, count: int) -> float:
        """Return a number of points as a share of all points, 0…1."""
        total = 0 if self.class_points is None else int(self.class_points.sum())
        return count / max(total, 1)

    def largest_classes(self, space: LabelSpace | None) -> dict[str, float]:
        """Return the share of the points, 0…1, of the largest predicted classes, by name.

        `space`: the classes; None if no points are labelled.
        """
        if space is None or self.class_points is None:
            return {}
        return largest_classes(space, self.class_points)


def largest_classes(space: LabelSpace, points: Counts) -> dict[str, float]:
    """Return the shares, 0…1, of the largest classes except class 0, by name.

    `points` (C,): number of points by train id.
    """
    largest = np.argsort(-points[1:], kind="stable")[:CLASSES_SHOWN] + 1
    return {space.names[i]: float(points[i] / points.sum()) for i in largest if points[i]}
