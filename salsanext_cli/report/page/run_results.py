# SPDX-License-Identifier: MIT
"""Results of a run, from which its page is put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.errors import counted, first_few, printable
from salsanext_cli.measures.drive import ScanRow
from salsanext_cli.measures.scan_counts import ScanCounts
from salsanext_cli.report.page.content import Comparison, content_of
from salsanext_cli.report.page.facts import facts_of_run, warnings_of_run
from salsanext_cli.report.page.html import PageContent
from salsanext_cli.report.page.shown_scans import ShownScan, read_shown
from salsanext_cli.results.selection import MissingResults


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """Results of a run in numbers per scan, and what its scans are read with."""

    out: Path
    rows: Sequence[ScanRow]  # Scans that could be read, in their order; at least one
    counts: ScanCounts | None  # Of the scans with labels; None without any
    missing: MissingResults  # Scans without results, left out
    how: dict[str, Any]  # Arguments that `read_row` and `read_shown` take alike for all scans

    def read(self, row: ScanRow, reason: str = "") -> ShownScan:
        """Read a scan to be shown; raises as `read_shown`."""
        return read_shown(row.file, reason, self.out, **self.how)

    def compared(self) -> Comparison | None:
        """Compare the scans that have labels with these; None without any."""
        return Comparison.of(self.counts, self.how["space"]) if self.counts else None

    def content(
        self,
        shown: Sequence[ShownScan],
        compared: Comparison | None,
        failed: Sequence[str],
        scales: Mapping[str, tuple[float, float]],
        served: Mapping[str, str] | None = None,
    ) -> PageContent:
        """Put the page together.

        `shown`, `compared`, `scales`, `served`: as for `content_of`; `failed`: reasons why scans
        are left out.
        """
        # The folder above often says more.
        title = "/".join(self.out.absolute().parts[-2:])
        space, sensor = self.how["space"], self.how["sensor"]
        warnings = [*self._warnings(), *map(printable, failed)]
        return content_of(
            *(title, facts_of_run(self.out, sensor), warnings),
            rows=self.rows,
            compared=compared,
            shown=shown,
            scales=scales,
            space=space,
            sensor=sensor,
            served=served,
        )

    def _warnings(self) -> list[str]:
        """Return every reason to doubt the page, a line each."""
        lines = warnings_of_run(self.out, {row.name for row in self.rows})
        if self.counts:
            lines = [*self.counts.label_warnings(self.how["space"]), *lines]
        for what, ids in (
            ("labels", self.counts.unknown_truth if self.counts else {}),
            ("predictions", self.counts.unknown_predictions if self.counts else {}),
        ):
            if ids:
                listed = first_few([f"{i} ({n:,}×)" for i, n in sorted(ids.items())])
                lines.append(f"{what}: unknown ids {listed} are taken as unlabelled")
        if self.missing.scans:
            lines.append(f"{counted(len(self.missing.scans), 'scan')} without results left out")
        return lines
