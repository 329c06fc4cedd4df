# SPDX-License-Identifier: MIT
"""Reach of the fusion of scans along a drive; this module imports nothing heavy."""

from dataclasses import dataclass

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import argument

MAX_REACH = 1000  # Largest reach in scans, each of some megabytes


@dataclass(frozen=True, slots=True)
class FusionReach:
    """Number of scans along a drive that vote for each other's labels.

    Attributes
    ----------
    reach : int
        Number of scans before and after a scan that vote.
    movable_reach : int
        The same for vehicles, people and riders, which may have moved.
    """

    reach: int = 20
    movable_reach: int = 3

    def __post_init__(self) -> None:
        if not 0 <= self.movable_reach <= self.reach <= MAX_REACH:
            problem = f"the values are {self.reach} and {self.movable_reach}"
            expected = f"0 ≤ movable reach ≤ reach ≤ {MAX_REACH}"
            raise UsageError(argument("reach", "movable_reach"), problem, expected)
