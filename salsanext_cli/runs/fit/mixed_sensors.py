# SPDX-License-Identifier: MIT
"""Scans of another sensor than most of those that a sensor was fitted to."""

from collections.abc import Mapping

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.geometry.scan_traits import ScanTraits, groups_of
from salsanext_cli.runs.scans.scan_file import ScanFile

SEPARATE_FOLDERS_HINT = "put the scans of each sensor into a separate folder"


def mixed_sensors(traits: Mapping[ScanFile, ScanTraits]) -> dict[ScanFile, Finding]:
    """Return a finding for each scan that differs in its sensor from most with the same fit."""
    findings: dict[ScanFile, Finding] = {}
    for sensor in dict.fromkeys(traits[file].sensor for file in sorted(traits)):
        files = [file for file in sorted(traits) if traits[file].sensor == sensor]
        groups = groups_of([traits[file] for file in files])
        first = files[groups.index(0)]
        for file, group in zip(files, groups, strict=True):
            if group:
                others = f"the others, such as {first.name} ({traits[first]})"
                problem = f"seems to be of another sensor ({traits[file]}) than {others}"
                findings[file] = Finding(WarningCode.MIXED_SENSORS, problem, SEPARATE_FOLDERS_HINT)
    return findings
