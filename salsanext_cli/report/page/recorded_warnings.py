# SPDX-License-Identifier: MIT
"""Recorded warnings about the scans of a run."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile

CHECKED_STAGES = ("project", *PREDICTION_STAGES)  # Stages that record warnings about scans


def warnings_of_run(out: Path, names: Collection[str]) -> list[str]:
    """Return the recorded warnings about some scans and sequences, one line per code."""
    texts: dict[str, dict[str, str]] = {}  # By code and name
    for name, finding in _findings(out):
        if name in names:
            text = f"{finding.problem}; {finding.hint}"
            texts.setdefault(finding.code, {}).setdefault(name, text)
    return [
        f"{code} in {counted(len(by_name), 'scan' if '/' in min(by_name) else 'sequence')} "
        f"({first_few([*by_name])}): {next(iter(by_name.values()))}"
        for code, by_name in sorted(texts.items())
    ]


def codes_by_scan(out: Path, files: Sequence[ScanFile]) -> dict[str, list[str]]:
    """Return the sorted codes of the warnings about each scan or its sequence, by name."""
    codes: dict[str, set[str]] = {}  # By name of the scan or sequence
    for name, finding in _findings(out):
        codes.setdefault(name, set()).add(finding.code)
    none = set[str]()
    return {
        file.name: sorted(codes.get(file.name, none) | codes.get(file.sequence, none))
        for file in files
    }


def _findings(out: Path) -> Iterator[tuple[str, Finding]]:
    """Yield every recorded warning with the name of its scan or sequence."""
    for stage in CHECKED_STAGES:
        for name, findings in OwnedFolder(out, stage).findings().items():
            for finding in findings:
                yield name, finding
