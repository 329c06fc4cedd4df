# SPDX-License-Identifier: MIT
"""Limits on scores, as `eval --fail-under` takes them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from salsanext_cli.errors import UsageError
from salsanext_cli.measures.scores import Scores

OPTION = "--fail-under"
EXAMPLE = "limits in %, such as mean_iou=40,accuracy=80"
FIELDS = {"accuracy": "accuracy", "mean_iou": "iou_mean_present"}
"""Field of `Scores` by the name of a limit."""


@dataclass(frozen=True, slots=True)
class LowScore:
    """Score below its limit."""

    name: str  # Name of the limit, a key of `FIELDS`
    score: float  # In %, NaN without labelled points
    limit: float  # In %

    @property
    def text(self) -> str:
        """Sentence for a message."""
        if math.isnan(self.score):
            return f"{OPTION}: {self.name} is not known, since no labelled point counts"
        return f"{OPTION}: {self.name} is {self.score:.4g} %, below {self.limit:g} %"


def limits_of(text: str | None) -> dict[str, float]:
    """Return the limits in % by name of a text such as ``mean_iou=40,accuracy=80``."""
    limits: dict[str, float] = {}
    for part in text.split(",") if text is not None else ():
        name, _, number = (word.strip() for word in part.partition("="))
        if name not in FIELDS:
            raise UsageError(OPTION, f"no score is called {name!r}", " or ".join(FIELDS))
        try:
            limit = float(number.removesuffix("%"))
        except ValueError:
            raise UsageError(OPTION, f"{number!r} is not a number", EXAMPLE) from None
        if not 0 <= limit <= 100:
            raise UsageError(OPTION, f"the limit of {name} is {number}", "0 to 100 %")
        if 0 < limit < 1 and not number.endswith("%"):
            hint = f"use {name}={100 * limit:g}, or {name}={number}% if this is meant"
            raise UsageError(OPTION, f"{name}={number} looks like a share", EXAMPLE, hint)
        limits[name] = limit
    return limits


def scores_below(limits: Mapping[str, float], scores: Scores) -> tuple[LowScore, ...]:
    """Return the scores that do not reach their limits; a NaN reaches none."""
    percentages = {name: 100 * float(getattr(scores, FIELDS[name])) for name in limits}
    return tuple(
        LowScore(name, percentages[name], limit)
        for name, limit in limits.items()
        if not percentages[name] >= limit
    )
