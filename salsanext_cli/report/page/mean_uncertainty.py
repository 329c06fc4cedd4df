# SPDX-License-Identifier: MIT
"""Titles of uncertainties on a page, and their means in words."""

from __future__ import annotations

from salsanext_cli.core.texts import percentage
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY

TITLES = {"error": "probability of error", "least_confidence": "1 − confidence"}
"""Titles that differ from the name of the kind."""


def title_of(kind: str) -> str:
    """Return the title of a kind of uncertainty."""
    return TITLES.get(kind, kind.replace("_", " "))


def is_share(kind: str) -> bool:
    """Return whether a kind is a probability or a share, 0…1, whose mean is in %."""
    return kind in UNCERTAINTY and UNCERTAINTY[kind].most == 1.0


def mean_in_words(kind: str, mean: float) -> str:
    """Return a mean uncertainty with its title."""
    value = percentage(mean) if is_share(kind) else f"{mean:.3g}"
    return f"mean {title_of(kind)} {value}"
