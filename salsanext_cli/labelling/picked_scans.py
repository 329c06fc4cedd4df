# SPDX-License-Identifier: MIT
"""Picked scans, and the record of a run of `pick`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.version import __version__

STAGE = "pick"
FAILURE_KEYS = ("scan", "reason", "code")


@dataclass(frozen=True, slots=True)
class PickedScan:
    """A picked scan, as record, table and JSON have it."""

    rank: int  # From 1, the scan most worth labelling
    sequence: str  # Its sequence and its name without suffix
    scan: str
    uncertainty: float  # Mean mutual information of its pixels, nats
    # Distance to the nearest scan picked before, 1 being that of two scans of the source (root mean
    # square); None for the first
    distance: float | None
    nearest: str | None  # That scan, as sequence/scan
    reason: str  # In words

    @property
    def name(self) -> str:
        """Sequence and scan."""
        return f"{self.sequence}/{self.scan}"


@dataclass(frozen=True, slots=True)
class PickRecord:
    """Record of a run of `pick`."""

    # Resolved settings that decide what is picked, as JSON gives them back
    settings: dict[str, Any]
    picked: list[PickedScan]  # In the order of their rank
    # `scan`, `reason` and `code` of each scan that could not be looked at
    failures: list[dict[str, str]]
    warnings: list[dict[str, Any]]  # Reasons to doubt scans, as `RunSummary.warnings` lists them
    # SHA-256 of the guessed labels that were written, by name of the scan
    guesses: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the record's file."""
        return {"stage": STAGE, "version": __version__, **asdict(self)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], path: Path) -> "PickRecord":
        """Read what `to_dict` returned from a file; `OutputError` if it is something else."""
        try:
            picked = [PickedScan(**row) for row in data["picked"]]
            failures = [{key: str(row[key]) for key in FAILURE_KEYS} for row in data["failures"]]
            warnings = [{**row, "scans": [*map(str, row["scans"])]} for row in data["warnings"]]
            settings, guesses = dict(data["settings"]), dict(data["guesses"])
            return cls(settings, picked, failures, warnings, guesses)
        except (TypeError, KeyError, ValueError) as error:
            remedy = "delete it or use another folder"
            raise OutputError(path, f"not what `{STAGE}` writes", remedy=remedy) from error
