# SPDX-License-Identifier: MIT
"""Outcome of a run over scans, and the scans that failed."""

from dataclasses import dataclass

from salsanext_cli.measures.scan_summary import RunSummary
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.selection import MissingResults


@dataclass(frozen=True, slots=True)
class Failure:
    """Scan that could not be worked on, the reason, and the code of the error."""

    scan: ScanFile
    reason: str
    code: str

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        return {"scan": str(self.scan.path), "reason": self.reason, "code": self.code}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Numbers of a run."""

    skipped: int  # Scans that were done already
    failures: tuple[Failure, ...]  # Scans that failed, in order
    done: int  # Scans that were worked on with success
    # Scans left out for want of results to work on, by a stage that looks for them
    missing: MissingResults | None = None
    seconds: float = 0.0  # Time of the work on scans, without the start of the command
    summary: RunSummary | None = None  # Of the scans that were worked on
    # Number of their points that were written as unlabelled for their error, if that was asked
    rejected_points: int | None = None
    # Number of their points, and of those among them that a stage kept that leaves some out
    kept_points: tuple[int, int] | None = None
