# SPDX-License-Identifier: MIT
"""Scans to show point by point, with all that is known about their points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.files.reading import present
from salsanext_cli.measures.histograms import lack_of_confidence
from salsanext_cli.measures.scan_counts import SOFTMAX, read_softmax
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ScanFile, output_path
from salsanext_cli.results.result_folder import ResultFolder, ScanResults
from salsanext_cli.sensors.sensor import Sensor

DOUBT = "doubt"
"""1 − the largest probability, which is shown as confidence."""
UNCERTAIN = ("error", "entropy", DOUBT, "epistemic", "aleatoric", "total", "mutual_information")
"""Values by which points can be hidden, in the order in which they are offered."""
SCALARS = (*UNCERTAIN, "range", "intensity")
"""Values that are shown on a scale; labels are not."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownScan:
    """Scan to show in a page."""

    name: str  # Sequence and stem
    reason: str  # Why it is shown
    results: ScanResults  # N points and what is known about them
    # (N,) float32 or None: 1 − the largest probability, NaN without one; None without probabilities
    doubt: Float | None

    def values(self) -> dict[str, npt.NDArray[Any]]:
        """Return all values of `SCALARS` that are known, (N,) each."""
        known = dict(self.results.uncertainty)
        known |= {"range": self.results.range, "intensity": self.results.scan.intensity}
        if self.doubt is not None:
            known[DOUBT] = self.doubt
        return {name: known[name] for name in SCALARS if name in known}


def read_shown(
    file: ScanFile,
    reason: str,
    out: Path,
    space: LabelSpace,
    labels: LabelSpace,
    merging: ClassMerging | None,
    sensor: Sensor,
) -> ShownScan:
    """Read a scan, its results, and the confidence of its points.

    Arguments are those of `count_scan`; the truth gets the raw ids of `space`.
    """
    found = ResultFolder(out).read(file, sensor, space, (labels, space))
    doubt = None
    if present(path := output_path(out, file.sequence, SOFTMAX, file.stem)):
        every = np.ones(len(found.scan), bool)
        doubt = lack_of_confidence(read_softmax(path, every, space, merging))
    return ShownScan(f"{file.sequence}/{file.stem}", reason, found, doubt)
