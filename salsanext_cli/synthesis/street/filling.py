# SPDX-License-Identifier: MIT
"""Objects scattered over a lot, parked on it, and houses at its back."""

from collections.abc import Callable

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Lot, Side
from salsanext_cli.synthesis.things import buildings, vegetation
from salsanext_cli.synthesis.things.vehicles import car

Span = tuple[float, float]
Sized = Callable[[Rng, float], Mesh]  # Returns an object of a size in metres
PLANTS = (
    (vegetation.bush, (0.12, 0.45), 0.5),
    (vegetation.bush, (0.4, 1.3), 0.5),
    (vegetation.ground_cover, (0.4, 1.8), 0.35),
)
"""Makers, sizes and relative numbers of the plants of a lot."""


def scatter(
    builder: Builder, side: Side, lot: Lot, make: Sized, size: Span, count: float, reach: float = 0
) -> None:
    """Scatter objects over the front of a lot, or `reach` metres deep if that is above 0."""
    depth = reach or lot.setback
    if depth < 0.8 or lot.end - lot.start < 1.5:
        return
    for _ in builder.count(count):
        s = builder.between(lot.start + 0.5, lot.end - 0.5)
        out = side.depth + builder.between(0.5, max(0.6, depth - 0.4))
        mesh = make(builder.rng, builder.between(*size))
        builder.put_if_free(mesh, side, s, out, 0.7, builder.between(0, 6.28))


def plant(builder: Builder, side: Side, lot: Lot, count: float, reach: float = 0) -> None:
    """Scatter low and high bushes and ground cover."""
    for make, size, share in PLANTS:
        scatter(builder, side, lot, make, size, share * count, reach)


def sizeless(make: Callable[[Rng], Mesh]) -> Sized:
    """Return a maker that ignores the size."""
    return lambda rng, _size: make(rng)


def house_behind(builder: Builder, side: Side, lot: Lot, out: float) -> None:
    """Build a house at a distance from the kerb in metres, on most lots that are wide enough."""
    width = lot.end - lot.start
    if width > 7 and builder.chance(0.8):
        floors = int(builder.rng.integers(1, 4))
        mesh = buildings.house(builder.rng, width * builder.between(0.6, 0.95), 10, floors)
        builder.put(mesh, side, (lot.start + lot.end) / 2, out)


def park(builder: Builder, side: Side, s: float, out: float, yaw: float, radius: float) -> None:
    """Place a parked car in either direction."""
    turned = yaw + np.pi * builder.chance(0.5) + builder.rng.normal(0, 0.03)
    builder.put_if_free(car(builder.rng), side, s, out, radius, turned)
