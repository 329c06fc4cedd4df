# SPDX-License-Identifier: MIT
"""Summary of a run over scans, from a few numbers about each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.coverage import CoverageCheck, FieldOfViewCoverage
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile

LARGEST_CLASSES = 5
"""Classes that a summary names."""
NOT_COUNTED = FieldOfViewCoverage()


@dataclass(frozen=True, slots=True)
class ScanSummary:
    """Numbers about one scan; small, since workers send them to the process that leads the run.

    Attributes
    ----------
    coverage : FieldOfViewCoverage
        Numbers of points in and out of the sensor's view, where they were counted.
    class_points : tuple of int
        Number of points by predicted train id; empty if none were predicted.
    """

    coverage: FieldOfViewCoverage = NOT_COUNTED
    class_points: tuple[int, ...] = ()

    @classmethod
    def of_labels(
        cls, labels: TrainIds, class_count: int, coverage: FieldOfViewCoverage = NOT_COUNTED
    ) -> ScanSummary:
        """Count the predicted train ids (N,) of a scan."""
        points = np.bincount(labels, minlength=class_count)
        return cls(coverage, tuple(points.tolist()))


@dataclass(slots=True)
class RunSummary:
    """Summary of the scans that a run has worked on.

    Attributes
    ----------
    sensor : Sensor
        Sensor that the scans were projected for.
    space : LabelSpace, optional
        Classes of the predicted points, if any are predicted.
    labelled : bool
        Whether the scans, or at least the first of them, have labels.
    class_points : list of int
        Number of points by predicted train id.
    check : CoverageCheck
        Warns of scans from another sensor.
    """

    sensor: Sensor
    space: LabelSpace | None = None
    labelled: bool = False
    class_points: list[int] = field(default_factory=list)
    check: CoverageCheck = field(init=False)

    def __post_init__(self) -> None:
        self.check = CoverageCheck(self.sensor)

    @classmethod
    def of_scans(
        cls, scans: Sequence[ScanFile], sensor: Sensor, space: LabelSpace | None = None
    ) -> RunSummary:
        """Begin the summary of a run over some scans."""
        return cls(sensor, space, bool(scans) and present(scans[0].label_path))

    def add(self, scan: ScanSummary) -> None:
        """Add a scan."""
        self.check.add(scan.coverage)
        if scan.class_points:
            before = self.class_points or [0] * len(scan.class_points)
            self.class_points = [a + b for a, b in zip(before, scan.class_points, strict=True)]

    def finish(self) -> RunSummary:
        """Warn of what the scans show as a whole, and return the summary."""
        self.check.finish()
        return self

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the points, 0…1, of the largest predicted classes, by name."""
        if self.space is None or not (points := sum(self.class_points)):
            return {}
        shares = {n: c / points for n, c in zip(self.space.names, self.class_points, strict=True)}
        largest = sorted(shares, key=lambda name: -shares[name])[:LARGEST_CLASSES]
        return {name: shares[name] for name in largest if shares[name]}
