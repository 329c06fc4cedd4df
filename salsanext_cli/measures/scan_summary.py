# SPDX-License-Identifier: MIT
"""Summary of a run over scans, from a few numbers about each."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.errors import printable
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.scan_checks import MIN_POINTS, Finding
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile

LARGEST_CLASSES = 5
"""Classes that a summary names."""
LARGEST_SHARE = 0.6
"""Largest share of a class in a scan that is believed; that of right settings was 0.44 or less."""
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ScanSummary:
    """Numbers about one scan; small, since workers send them to the process that leads the run.

    Attributes
    ----------
    file : ScanFile
    findings : tuple of Finding
        Reasons to doubt the scan.
    class_points : tuple of int
        Number of points by predicted train id; empty if none were predicted.
    """

    file: ScanFile
    findings: tuple[Finding, ...] = ()
    class_points: tuple[int, ...] = ()

    @classmethod
    def of_labels(
        cls, file: ScanFile, labels: TrainIds, space: LabelSpace, findings: tuple[Finding, ...] = ()
    ) -> ScanSummary:
        """Count the predicted train ids (N,) of a scan."""
        points = np.bincount(labels, minlength=space.class_count)
        return cls(file, findings, tuple(points.tolist()))


def _of_classes(points: Sequence[int], space: LabelSpace, out: Path | None) -> Iterator[Finding]:
    """Look at the number of points by class, of results in a folder; class 0 is unlabelled."""
    total, largest = sum(points[1:]), max(range(1, len(points)), key=points.__getitem__, default=0)
    if total >= MIN_POINTS and points[largest] > LARGEST_SHARE * total:
        found = f"{points[largest] / total:.0%} of the points are {space.names[largest]}"
        look = shlex.join(["salsanext", "export-ply", *([str(out)] if out else [])])
        yield Finding("one-class", found, f"look at them: `{look}`")


@dataclass(slots=True)
class RunSummary:
    """Summary of the scans that a run has worked on.

    Attributes
    ----------
    sensor : Sensor
        Sensor that the scans were projected for.
    space : LabelSpace, optional
        Classes of the predicted points, if any are predicted.
    out : Path, optional
        Folder of the results, as it was typed.
    labelled : bool
        Whether the scans, or at least the first of them, have labels.
    class_points : list of int
        Number of points by predicted train id.
    findings : dict
        Names of the scans by what was found, in the order in which it was found first.
    """

    sensor: Sensor
    space: LabelSpace | None = None
    out: Path | None = None
    labelled: bool = False
    class_points: list[int] = field(default_factory=list)
    findings: dict[str, list[tuple[str, Finding]]] = field(default_factory=dict)

    @classmethod
    def of_scans(
        cls,
        scans: Sequence[ScanFile],
        sensor: Sensor,
        space: LabelSpace | None = None,
        out: Path | None = None,
    ) -> RunSummary:
        """Begin the summary of a run over some scans."""
        return cls(sensor, space, out, bool(scans) and present(scans[0].label_path))

    def add(self, scan: ScanSummary) -> None:
        """Add a scan; say at once what is found for the first time."""
        name = f"{scan.file.sequence}/{scan.file.stem}"
        of_classes = _of_classes(scan.class_points, self.space, self.out) if self.space else ()
        for finding in (*scan.findings, *of_classes):
            if finding.code not in self.findings:
                warning = f"{finding.found}; {finding.remedy}"
                log.warning("%s: %s (%s)", printable(name), warning, finding.code)
            self.findings.setdefault(finding.code, []).append((name, finding))
        if scan.class_points:
            before = self.class_points or [0] * len(scan.class_points)
            self.class_points = [a + b for a, b in zip(before, scan.class_points, strict=True)]

    def warnings(self) -> list[dict[str, Any]]:
        """Return what was found, by code, with the scans, as plain data."""
        return [
            {
                "code": code,
                "message": found[0][1].found,
                "remedy": found[0][1].remedy,
                "scans": sorted(name for name, _ in found),
            }
            for code, found in self.findings.items()
        ]

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the points, 0…1, of the largest predicted classes, by name."""
        if self.space is None or not (points := sum(self.class_points)):
            return {}
        shares = {n: c / points for n, c in zip(self.space.names, self.class_points, strict=True)}
        largest = sorted(shares, key=lambda name: -shares[name])[:LARGEST_CLASSES]
        return {name: shares[name] for name in largest if shares[name]}
