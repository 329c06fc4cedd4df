# SPDX-License-Identifier: MIT
"""Kinds of street: how wide, how green, how crowded."""

from __future__ import annotations

from dataclasses import dataclass

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Style:
    """Ranges and chances a street is drawn from; lengths in metres.

    Attributes
    ----------
    name : str
        What to call it.
    lane : (low, high)
        Half the width of the carriageway.
    parking, verge, sidewalk : chances 0…1
        That a side of the street has such a strip.
    sidewalk_width : (low, high)
        Of the pavement.
    lots : dict of str to float
        Kinds of lot along the street and how usual each is.
    setback : (low, high)
        From the pavement to the house front.
    lot_width : (low, high)
        Along the street.
    tree_gap : (low, high)
        Between street trees.
    parked : float
        Chance that a parking space is taken.
    crossing_gap : (low, high)
        Between side streets.
    crowd : float
        People and bicycles per 100 m of side.
    traffic : float
        Vehicles per 100 m of lane.
    """

    name: str
    lane: Span
    parking: float
    verge: float
    sidewalk: float
    sidewalk_width: Span
    lots: dict[str, float]
    setback: Span
    lot_width: Span
    tree_gap: Span
    parked: float
    crossing_gap: Span
    crowd: float
    traffic: float


URBAN = Style(
    name="urban", lane=(3.4, 6.2), parking=0.35, verge=0.2, sidewalk=1.0, sidewalk_width=(2.4, 7.0),
    lots={"terrace": 7, "yard": 1, "carpark": 1, "green": 1, "house": 1},
    setback=(0.0, 1.5), lot_width=(9, 22), tree_gap=(10, 25), parked=0.5, crossing_gap=(45, 90),
    crowd=9.0, traffic=1.6,
)  # fmt: skip
RESIDENTIAL = Style(
    name="residential", lane=(2.8, 4.3), parking=0.15, verge=0.4, sidewalk=1.0,
    sidewalk_width=(1.7, 4.2),
    lots={"house": 7, "yard": 2, "green": 1, "terrace": 2, "carpark": 0.5, "thicket": 1.5},
    setback=(2.0, 7.0), lot_width=(10, 20), tree_gap=(9, 22), parked=0.42, crossing_gap=(40, 90),
    crowd=5.0, traffic=0.8,
)  # fmt: skip
BOULEVARD = Style(
    name="boulevard", lane=(4.2, 7.5), parking=0.25, verge=0.9, sidewalk=0.95,
    sidewalk_width=(2.5, 6.0),
    lots={"terrace": 2, "green": 3, "thicket": 3, "yard": 2, "carpark": 1.5, "house": 1},
    setback=(2.0, 10.0), lot_width=(14, 30), tree_gap=(7, 14), parked=0.5, crossing_gap=(60, 120),
    crowd=7.0, traffic=2.0,
)  # fmt: skip
COUNTRY = Style(
    name="country", lane=(3.0, 4.4), parking=0.03, verge=1.0, sidewalk=0.3,
    sidewalk_width=(1.2, 2.2),
    lots={"field": 4, "thicket": 5, "green": 3, "house": 1, "yard": 1},
    setback=(5.0, 14.0), lot_width=(14, 40), tree_gap=(12, 40), parked=0.1, crossing_gap=(80, 160),
    crowd=2.5, traffic=1.0,
)  # fmt: skip
STYLES = (RESIDENTIAL, URBAN, RESIDENTIAL, COUNTRY, BOULEVARD)
"""Styles in the order in which sequences take them; a small data set has all."""
