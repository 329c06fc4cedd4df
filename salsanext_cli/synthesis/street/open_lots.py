# SPDX-License-Identifier: MIT
"""Lots without a house at the street: lawns, meadows, yards, building sites."""

from functools import partial

import numpy as np

from salsanext_cli.synthesis.street.boundaries import boundary, hedge
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.filling import house_behind, park, scatter, sizeless
from salsanext_cli.synthesis.street.plan import Lot, Side
from salsanext_cli.synthesis.things import fences, furniture, vegetation
from salsanext_cli.synthesis.things.vehicles import length_of, vehicle

PER_M2 = 1 / 400  # Trees of a lawn per square metre


def lawn(builder: Builder, side: Side, lot: Lot) -> None:
    """Leave mown grass open to the pavement, with few trees, before a house or a hedge."""
    width = lot.end - lot.start
    depth = lot.setback
    scatter(builder, side, lot, vegetation.tree, (4.0, 11.0), PER_M2 * width * depth)
    if builder.chance(0.4):
        scatter(builder, side, lot, vegetation.bush, (0.3, 1.2), 2 * PER_M2 * width * depth)
    if builder.chance(0.3):
        scatter(builder, side, lot, sizeless(furniture.post), (0, 1), 0.5)
    back = side.depth + lot.setback
    if builder.chance(0.45):
        house_behind(builder, side, lot, back)
    elif builder.chance(0.5):
        line = hedge(builder) if builder.chance(0.5) else boundary(builder)
        builder.put_line(line, side, lot.start, lot.end, back)


def meadow(builder: Builder, side: Side, lot: Lot) -> None:
    """Grow bushes and trees in high grass, which is part of the ground."""
    area = (lot.end - lot.start) / 8
    scatter(builder, side, lot, vegetation.bush, (0.3, 1.5), 0.6 * area, reach=25)
    scatter(builder, side, lot, vegetation.tree, (3.0, 10.0), 0.4 * area, reach=30)
    scatter(builder, side, lot, vegetation.weeds, (0.6, 2.0), 2.0 * area, reach=12)
    if builder.chance(0.25):
        out = side.depth + builder.between(0.5, 4)
        builder.put_line(boundary(builder), side, lot.start, lot.end, out)


def court(builder: Builder, side: Side, lot: Lot) -> None:
    """Leave a yard open or fence it off; vehicles, clutter and a building stand on it."""
    if builder.chance(0.4):
        builder.put_line(boundary(builder), side, lot.start, lot.end, side.depth + 0.2)
    for s in np.arange(lot.start + 3, lot.end - 3, builder.between(4, 9)):
        if builder.chance(0.5):
            mesh = vehicle(builder.rng, builder.plan.style.vehicles)
            half = max(2.4, length_of(mesh) / 2)
            out = side.depth + builder.between(half + 1, max(half + 1.1, lot.setback - half))
            builder.put_if_free(mesh, side, float(s), out, half, builder.between(0, 6.28))
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 1.5)
    if builder.chance(0.7):
        house_behind(builder, side, lot, side.depth + lot.setback)


def site(builder: Builder, side: Side, lot: Lot) -> None:
    """Fence a building site off, with heaps, crates and vehicles on bare ground."""
    kind = "hoarding" if builder.chance(0.3) else "site"
    height = builder.between(1.8, 2.2)
    shade = builder.between(0.6, 1.4)
    make = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
    front = side.depth + builder.between(0.1, 0.6)
    back = side.depth + lot.setback
    builder.put_line(make, side, lot.start, lot.end, front)
    if builder.chance(0.6):
        builder.put_outward(make, side, lot.start + 0.1, front, back)
        builder.put_outward(make, side, lot.end - 0.1, front, back)
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 4.0)
    if builder.chance(0.6):
        middle = (lot.start + lot.end) / 2
        park(builder, side, middle, side.depth + lot.setback / 2 + 1, builder.between(0, 3), 2.4)
    if builder.chance(0.4):
        house_behind(builder, side, lot, back)
