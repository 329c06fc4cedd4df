# SPDX-License-Identifier: MIT
"""Finding of a check: a reason to doubt the labels of a scan."""

from dataclasses import dataclass

from salsanext_cli.core.texts import with_hint


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """Reason to doubt the labels of a scan; sorted by code and texts."""

    code: str  # A `WarningCode`, or one of another version that a record has
    problem: str
    hint: str

    def about(self, name: str) -> str:
        """Return the text of a warning about the scan of a name."""
        return with_hint(f"{name}: {self.problem} ({self.code})", self.hint)
