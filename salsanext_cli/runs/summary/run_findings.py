# SPDX-License-Identifier: MIT
"""Findings of a run: reasons to doubt its scans, logged as they are found."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, hint_in, log_finding, log_text

log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class RunFindings:
    """Reasons to doubt scans and sequences of a run."""

    # Names and findings of scans and sequences by code
    by_code: dict[str, list[tuple[str, Finding]]] = field(default_factory=dict)
    # Names of scans of earlier runs whose results are in the folder, by code of their warnings
    earlier: dict[str, list[str]] = field(default_factory=dict)
    out: Path | None = None  # Folder of the results, for hints

    def __bool__(self) -> bool:
        """Return whether there is a reason to doubt a scan of this run."""
        return bool(self.by_code)

    def add(self, name: str, finding: Finding) -> None:
        """Add a reason to doubt a scan; log it if it is the first of its code."""
        if finding.code not in self.by_code:
            log_finding(name, finding, self.out)
        self.by_code.setdefault(finding.code, []).append((name, finding))

    def add_of_sequence(self, name: str, findings: Iterable[Finding]) -> None:
        """Add and log reasons to doubt a whole sequence."""
        for finding in findings:
            log_finding(f"sequence {name}", finding, self.out)
            self.by_code.setdefault(finding.code, []).append((name, finding))

    def add_of_all(self, names: Iterable[str], finding: Finding) -> None:
        """Add a reason to doubt all scans of some names; log it once, for the first of them."""
        for name in sorted(names):
            self.add(name, finding)

    def add_others(self, step: RunFindings) -> None:
        """Add the findings of a further step on these scans, at most one of each code and name."""
        for code, findings in step.by_code.items():
            own_findings = self.by_code.setdefault(code, [])
            names = {name for name, _ in own_findings}
            own_findings += [(name, finding) for name, finding in findings if name not in names]

    def log_numbers(self) -> None:
        """Log the number of further scans with each warning."""
        for code, findings in sorted(self.by_code.items()):
            others = sorted(name for name, _ in findings[1:] if "/" in name)
            if others:
                count = counted(len(others), "more scan")
                log.warning("%s in %s: %s", code, count, log_text(first_few(others)))

    def names_by_code(self) -> dict[str, set[str]]:
        """Return the names of the scans with each warning, those of earlier runs too, by code."""
        names = {code: {*earlier} for code, earlier in self.earlier.items()}
        for code, findings in self.by_code.items():
            names.setdefault(code, set()).update(name for name, _ in findings)
        return names

    def warnings(self) -> list[ScanWarning]:
        """Return a warning for each code, with the text of its first scan and the names of all."""
        warnings = []
        for code in sorted(self.by_code):
            findings = sorted(self.by_code[code], key=itemgetter(0))
            first = findings[0][1]
            warnings.append(
                ScanWarning(
                    code=code,
                    message=first.problem,
                    hint=hint_in(self.out, first.hint),
                    scans=[name for name, _ in findings],
                )
            )
        return warnings
