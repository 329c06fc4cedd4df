# SPDX-License-Identifier: MIT
"""Level of `tune risk`, and whether the scans are enough for it; nothing here reads a scan."""

import logging
import math
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import TrainingError, UsageError
from salsanext_cli.core.measures.risk_control import (
    allowed_scans,
    needed_scans,
    share_left,
    useful_scans,
)
from salsanext_cli.core.texts import counted, percentage, with_hint
from salsanext_cli.core.wording import argument, share

log = logging.getLogger(__name__)


class TooFewScansError(TrainingError):
    """A level cannot be guaranteed by so few scans or drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RiskLevel:
    """Limit of the share of accepted and wrong points."""

    at_most: float  # Largest share of the points, 0…1
    # Share of scans or drives within the limit; None: it is for the mean
    confidence: float | None = None

    def require_possible(self) -> None:
        """Refuse shares outside their ranges."""
        if not 0 < self.at_most < 1:
            problem = f"is {self.at_most:.4g}"
            raise UsageError(argument("at_most"), problem, "above 0 and below 100%, such as 5%")
        if self.confidence is not None and not 0.5 <= self.confidence < 1:
            problem = f"is {self.confidence:.4g}"
            raise UsageError(argument("confidence"), problem, "from 50% to below 100%")


def require_scans(source: Path, count: int, level: RiskLevel) -> None:
    """Refuse a level that so many scans are too few for; name the best one for their number."""
    level.require_possible()
    confidence = level.confidence
    missing = needed_scans(level.at_most, confidence) - count
    if missing <= 0:
        return
    if confidence is None:
        lowest = math.ceil(1000 / (count + 1)) / 10
        # The lowest level leaves no room for wrong points: ((n + 1) L - 1) / n = L / 2.
        useful = min(math.ceil(2000 / (count + 2)) / 10, 95.0)
        best = f"{lowest:g} %"
        needed = counted(useful_scans(level.at_most, confidence) - count, "more scan")
        room = (
            f"{share('at_most', useful / 100)}, which leaves half of it for wrong points; "
            f"{needed} would leave half of {percentage(level.at_most, figures=3)}"
        )
    else:
        exceed = 1 - (1 - confidence) ** (1 / max(count, 1))  # Clopper and Pearson's bound
        best = f"{percentage(exceed, 0)} of scans above the level, "
        best += f"with {percentage(confidence, figures=4)} confidence"
        room = f"a lower {argument('confidence')}"
    problem = f"{counted(count, 'scan')} cannot guarantee less than {best}"
    hint = f"add scans of other drives, or use {room}"
    raise TooFewScansError(source, problem, counted(missing, "more scan"), hint)


@dataclass(frozen=True, slots=True, kw_only=True)
class FewUnits:
    """Scans or drives that leave a threshold little or no room for wrong labels."""

    unit: str  # "scan" or "drive"
    count: int
    level: RiskLevel
    useful: int  # Number of them that leaves room, as `useful_scans` returns it

    @classmethod
    def among(cls, count: int, unit: str, level: RiskLevel) -> "FewUnits | None":
        """Return so many scans or drives if they are few for a level, else None."""
        useful = useful_scans(level.at_most, level.confidence)
        if count >= useful:
            return None
        return cls(unit=unit, count=count, level=level, useful=useful)

    @property
    def left(self) -> float:
        """Share of the points, or of the scans above the level, that the level leaves, 0…1."""
        return _left(self.count, self.level)

    def warn_before(self) -> None:
        """Warn of the room that the bound leaves, before a scan is read."""
        units = counted(self.count, self.unit)
        more = counted(self.useful, self.unit)
        useful = percentage(_left(self.useful, self.level), figures=3)
        limit = percentage(self.level.at_most, figures=3)
        if self.level.confidence is not None:
            text = f"{units}: none of them may exceed {limit}; with {more} one may"
        elif self.left < 0.0005:
            text = (
                f"{units}: the threshold accepts only labels below the first wrong one; with "
                f"{more} {useful} of the points may be accepted and wrong"
            )
        else:
            text = (
                f"{units}: {percentage(self.left, figures=2)} of the points of these may be "
                f"accepted and wrong, not {limit}; with {more} {useful}"
            )
        log.warning("%s", with_hint(text, self.hint))

    def warn_after(self, accepted: float, accepted_by_useful: float) -> None:
        """Warn of the share of accepted points, and of that by more scans with equal losses."""
        units = counted(self.count, self.unit)
        more = counted(self.useful, self.unit)
        text = (
            f"{units}: the threshold accepts {percentage(accepted)} of the points; {more} like "
            f"these would accept about {percentage(accepted_by_useful, 0)}"
        )
        log.warning("%s", with_hint(text, self.hint))

    @property
    def hint(self) -> str:
        """What helps."""
        more = counted(self.useful - self.count, f"more {self.unit}")
        return f"label {more}, or raise {argument('at_most')}"


def _left(count: int, level: RiskLevel) -> float:
    """Return what a level leaves to a number of scans or drives, as `FewUnits.left`."""
    if level.confidence is None:
        return max(0.0, share_left(count, level.at_most))
    return max(0, allowed_scans(count, level.confidence)) / count
