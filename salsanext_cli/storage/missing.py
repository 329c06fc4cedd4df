# SPDX-License-Identifier: MIT
"""Scans without results: those that should have some, and those that nobody asked for."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.sources import asked_for
from salsanext_cli.storage.stage_records import owner

LABELLING = ("predict", "knn-refine", "uncertainty")
"""The stages whose results later ones read."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Absent:
    """Scans without results.

    Attributes
    ----------
    missing : tuple of ScanFile
        Those that a stage was asked for: it failed, or was interrupted, or they were deleted. All
        where nobody recorded what a stage was asked for.
    unasked : int
        How many others there are; they were left out on purpose.
    """

    missing: tuple[ScanFile, ...] = ()
    unasked: int = 0

    def complain(self, scans: int, what: str) -> None:
        """Say how many of the scans lack what they should have."""
        if self.missing:
            first = self.missing[0]
            log.error(
                "%d of %d scans have no %s and are left out, the first is %s/%s",
                *(len(self.missing), scans, what, first.sequence, first.stem),
            )

    def words(self, what: str) -> str:
        """Return what follows the number of scans done in a sentence."""
        return f", {self.unasked} not asked for have no {what}" if self.unasked else ""


def without_predictions(out: Path, scans: Iterable[ScanFile]) -> Absent:
    """Divide scans without predictions by whether the stage that predicts was asked for them."""
    stage = owner(out, "predictions") or ""

    def wanted(asked: dict[str, set[str]]) -> set[str] | None:
        # `knn-refine` takes what `predict` left, wherever that came from.
        return asked.get(stage, asked.get("predict"))

    return _divided(out, scans, wanted)


def without_results(out: Path, scans: Iterable[ScanFile]) -> Absent:
    """Divide scans without labels and uncertainty by whether any stage was asked for them."""

    def wanted(asked: dict[str, set[str]]) -> set[str] | None:
        known = [asked[stage] for stage in LABELLING if stage in asked]
        return set().union(*known) if known else None

    return _divided(out, scans, wanted)


def _divided(
    out: Path,
    scans: Iterable[ScanFile],
    wanted: Callable[[dict[str, set[str]]], set[str] | None],
) -> Absent:
    listed = sorted(scans, key=lambda scan: (scan.sequence, scan.stem))
    stems = {
        sequence: wanted(asked_for(out, sequence)) for sequence in {s.sequence for s in listed}
    }

    def is_wanted(scan: ScanFile) -> bool:
        of_sequence = stems[scan.sequence]
        return of_sequence is None or scan.stem in of_sequence

    missing = tuple(scan for scan in listed if is_wanted(scan))
    return Absent(missing, len(listed) - len(missing))
