# SPDX-License-Identifier: MIT
"""Result of checking a scan."""

from dataclasses import dataclass

from salsanext_cli.fitting.scan_traits import ScanTraits

MIN_POINTS = 100
"""Fewest points of which a check says something."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Reason to doubt the labels of a scan."""

    code: str  # Name of the check, which stays; see docs/checks.md
    found: str  # What is doubtful about this scan, and what to do
    remedy: str


@dataclass(frozen=True, slots=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor."""

    findings: tuple[Finding, ...] = ()
    # None of a scan of fewer than `MIN_POINTS` points with a measurement
    traits: ScanTraits | None = None
    ego_share: float = 0.0  # Share of the points on the housing of the sensor or its vehicle, 0…1


UNCHECKED = ScanCheck()
