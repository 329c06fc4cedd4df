# SPDX-License-Identifier: MIT
"""Result of checking a scan."""

from dataclasses import dataclass

from salsanext_cli.fitting.scan_traits import ScanTraits

MIN_POINTS = 100
"""Fewest points of which a check says something."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Reason to doubt the labels of a scan.

    Attributes
    ----------
    code : str
        Name of the check, which stays; see docs/checks.md.
    found, remedy : str
        What is doubtful about this scan, and what to do.
    """

    code: str
    found: str
    remedy: str


@dataclass(frozen=True, slots=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor.

    Attributes
    ----------
    findings : tuple of Finding
    traits : ScanTraits, optional
        None of a scan of fewer than `MIN_POINTS` points with a measurement.
    ego_share : float
        Share of the points on the housing of the sensor or its vehicle, 0…1.
    """

    findings: tuple[Finding, ...] = ()
    traits: ScanTraits | None = None
    ego_share: float = 0.0


UNCHECKED = ScanCheck()
