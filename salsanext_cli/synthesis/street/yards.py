# SPDX-License-Identifier: MIT
"""Trucks, buses, trailers and site vehicles on open ground beside the street."""

import numpy as np

from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things.other_vehicles import other_vehicle
from salsanext_cli.synthesis.things.trucks import truck
from salsanext_cli.synthesis.things.vehicles import length_of

OPEN = ("court", "site", "field", "meadow", "green", "carpark", "forecourt", "lawn", "yard")
"""Kinds of lot whose front has no house."""
NEAREST_M = 0.4
FARTHEST_M = 22.0
"""Least and largest distance of the nearest edge of a vehicle from the pavement."""


def furnish(builder: Builder, side: Side) -> None:
    """Place vehicles on the open lots of one side, in number as the style has them."""
    for lot in side.lots:
        if lot.kind in OPEN:
            for _ in builder.count(builder.plan.style.open_ground * (lot.end - lot.start) / 100):
                s = builder.between(lot.start, lot.end)
                _vehicle(builder, side, s)


def _vehicle(builder: Builder, side: Side, s: float) -> None:
    make = truck if builder.chance(0.4) else other_vehicle
    mesh = make(builder.rng)
    yaw = builder.rng.choice([0, np.pi / 2, np.pi, -np.pi / 2]) + builder.rng.normal(0, 0.3)
    reach = length_of(mesh) / 2
    out = side.depth + reach + builder.between(NEAREST_M, FARTHEST_M * builder.between(0.2, 1))
    builder.put_if_free(mesh, side, s, out, max(1.5, reach - 0.3), yaw)
