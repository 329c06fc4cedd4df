# SPDX-License-Identifier: MIT
"""Selection among the scans of a source, by split, sequence and number."""

from dataclasses import dataclass

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import argument

PICKED_SCANS = 10  # Number of scans that `pick` chooses by default


@dataclass(frozen=True, slots=True)
class ScanSelection:
    """Selection among the scans of a source; all of them by default.

    Attributes
    ----------
    split : str, optional
        Only the sequences of this split.
    sequences : tuple of str
        Only these sequences, if any.
    limit : int, optional
        Only the first scans, so many.
    """

    split: str | None = None
    sequences: tuple[str, ...] = ()
    limit: int | None = None

    def __post_init__(self) -> None:
        if self.split is not None and self.sequences:
            both = argument("split", "sequences")
            raise UsageError(both, "both were given", "one of them")
        if self.limit is not None and self.limit < 1:
            problem = f"the number of scans is {self.limit}"
            raise UsageError(argument("limit"), problem, "at least 1")
