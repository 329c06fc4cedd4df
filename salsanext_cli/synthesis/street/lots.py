# SPDX-License-Identifier: MIT
"""Objects on the lots beside the street, and their fences, walls and hedges."""

from collections.abc import Callable
from functools import partial

import numpy as np

from salsanext_cli.synthesis.street import open_lots
from salsanext_cli.synthesis.street.boundaries import boundary, close, hedge, undergrowth
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.filling import house_behind, park, plant, scatter, sizeless
from salsanext_cli.synthesis.street.plan import REACH_M, Lot, Side
from salsanext_cli.synthesis.things import (
    buildings,
    fences,
    furniture,
    pedestrians,
    people,
    vegetation,
)
from salsanext_cli.synthesis.things.trucks import truck
from salsanext_cli.synthesis.things.vehicles import length_of, vehicle

CAR_ROOM_M = 5.2  # Distance from the kerb to the house that a car in the driveway needs


def furnish(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a lot and its background."""
    KINDS[lot.kind](builder, side, lot)
    _background(builder, side, lot)


def _terrace(builder: Builder, side: Side, lot: Lot) -> None:
    width = lot.end - lot.start
    rng = builder.rng
    front = side.depth + lot.setback
    floors = int(rng.integers(2, 6))
    if width > 5:
        passage = builder.between(1.5, 4) if builder.chance(0.15) and width > 10 else 0.0
        mesh = buildings.house(rng, width - passage - 0.05, builder.between(8, 14), floors)
        builder.put(mesh, side, (lot.start + lot.end - passage) / 2, front)
        _overgrow(builder, side, lot, front)
        if passage:
            arch = buildings.arch(rng, passage + 0.1, 3.0 * floors)
            builder.put(arch, side, lot.end - passage / 2, front)
    if lot.setback > 0.8:
        close(builder, side, lot.start, lot.end, side.depth + 0.2, open_chance=0.3)
    plant(builder, side, lot, lot.setback / 3)


def _overgrow(builder: Builder, side: Side, lot: Lot, front: float) -> None:
    """Grow ivy up a house, bushes along it, or a tree that touches it."""
    start = builder.between(lot.start, (lot.start + lot.end) / 2)
    end = builder.between(start + 1, lot.end)
    if builder.chance(0.15):
        ivy = partial(vegetation.ivy, builder.rng, height=builder.between(2, 8))
        builder.put_line(ivy, side, start, end, front)
    if builder.chance(0.2) and lot.setback > 0.7:
        for s in np.arange(start, end, builder.between(0.8, 1.5)):
            bush = vegetation.bush(builder.rng, builder.between(0.4, 0.9))
            builder.put(bush, side, float(s), front - 0.5)
    if builder.chance(0.2) and lot.setback > 1:
        for s in np.arange(start, end, builder.between(2, 6)):
            tree = vegetation.tree(builder.rng, builder.between(3, 9))
            builder.put_if_free(tree, side, float(s), front - builder.between(0.6, 1.5), 0.5)


def _house(builder: Builder, side: Side, lot: Lot) -> None:
    width = lot.end - lot.start
    rng = builder.rng
    front = side.depth + lot.setback
    gap = builder.between(2.5, 6)
    drive = lot.drive[1] - lot.drive[0]
    if drive and builder.chance(0.55) and front > CAR_ROOM_M:
        park(builder, side, sum(lot.drive) / 2, front - min(2.6, lot.setback / 2), np.pi / 2, 2.0)
    if width - gap > 5:
        depth = builder.between(7, 12)
        middle = lot.end - 0.7 - (width - gap) / 2
        mesh = buildings.house(rng, width - gap, depth, int(rng.integers(1, 4)))
        builder.put(mesh, side, middle, front)
        _overgrow(builder, side, lot, front)
        if drive and builder.chance(0.5):
            garage = buildings.garage(rng)
            builder.put(garage, side, sum(lot.drive) / 2, front + builder.between(0, 5))
        elif builder.chance(0.7):
            close(builder, side, lot.start, lot.start + gap, front + 1)
    gate = lot.start if drive else builder.between(lot.start + 1, lot.end - 2)
    gate_end = lot.drive[1] if drive else gate + 1.2
    for start, end in ((lot.start, gate), (gate_end, lot.end)):
        close(builder, side, start, end, side.depth + builder.between(0.1, 0.4))
    plant(builder, side, lot, lot.setback * width / 18)
    if builder.chance(0.75) and lot.setback > 2:
        kind = vegetation.tree if builder.chance(0.7) else vegetation.conifer
        scatter(builder, side, lot, kind, (3.0, 8.0), 1.2)
    if builder.chance(0.5):
        end = front + builder.between(2, 12)
        builder.put_outward(boundary(builder), side, lot.end, side.depth + 0.3, end)
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 0.8)
    scatter(builder, side, lot, sizeless(people.motorcycle), (0, 1), 0.12)


def _yard(builder: Builder, side: Side, lot: Lot) -> None:
    close(builder, side, lot.start, lot.end, side.depth + 0.25, open_chance=0.0)
    scatter(builder, side, lot, vegetation.tree, (4.0, 9.0), 1.5, reach=15)
    plant(builder, side, lot, 4, reach=12)
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 1.5, reach=8)
    if builder.chance(0.35):
        park(builder, side, builder.between(lot.start + 2, lot.end - 2), side.depth + 5, 0.3, 2.0)
    if builder.chance(0.5) and lot.end - lot.start > 8:
        garage = buildings.garage(builder.rng)
        middle = (lot.start + lot.end) / 2
        builder.put(garage, side, middle, side.depth + builder.between(4, 12))


def _green(builder: Builder, side: Side, lot: Lot) -> None:
    area = (lot.end - lot.start) / 8
    scatter(builder, side, lot, vegetation.tree, (4.0, 11.0), 2.0 * area, reach=25)
    scatter(builder, side, lot, vegetation.conifer, (3.0, 9.0), 0.5 * area, reach=25)
    plant(builder, side, lot, 3.0 * area, reach=20)
    scatter(builder, side, lot, vegetation.weeds, (0.5, 1.6), 2.0 * area, reach=15)
    scatter(builder, side, lot, sizeless(pedestrians.bystander), (0, 1), 0.5 * area, reach=12)
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 0.5 * area, reach=6)


def _field(builder: Builder, side: Side, lot: Lot) -> None:
    area = (lot.end - lot.start) / 8
    scatter(builder, side, lot, vegetation.bush, (0.4, 2.0), 0.9 * area, reach=30)
    scatter(builder, side, lot, vegetation.tree, (4.0, 11.0), 0.5 * area, reach=40)
    scatter(builder, side, lot, vegetation.weeds, (0.6, 2.0), 4.0 * area, reach=15)
    is_barrier = builder.chance(0.3)
    if is_barrier or builder.chance(0.25):
        kind, out = ("barrier", 0.8) if is_barrier else ("mesh", 3.0)
        shade = builder.between(0.7, 1.4)
        height = builder.between(0.9, 1.3)
        fence = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
        builder.put_line(fence, side, lot.start, lot.end, side.depth + out)


def _thicket(builder: Builder, side: Side, lot: Lot) -> None:
    bushes = undergrowth(builder, (2.5, 7), (3, 8))
    if builder.chance(0.5):
        close(builder, side, lot.start, lot.end, side.depth + 0.2, open_chance=0.3)
    out = side.depth + builder.between(0.8, 4)
    builder.put_line(bushes, side, lot.start, lot.end, out)
    if builder.chance(0.2):
        house_behind(builder, side, lot, out + builder.between(6, 16))


def _scrub(builder: Builder, side: Side, lot: Lot) -> None:
    out = side.depth + builder.between(0.3, 1.5)
    scrub = hedge(builder) if builder.chance(0.55) else undergrowth(builder, (1.5, 5), (1.5, 4))
    builder.put_line(scrub, side, lot.start, lot.end, out + 0.4)
    scatter(builder, side, lot, vegetation.tree, (4.0, 10.0), 2.0, reach=12)
    house_behind(builder, side, lot, out + builder.between(4, 14))


def _high_wall(builder: Builder, side: Side, lot: Lot) -> None:
    """Set up a garden wall or a solid fence, and trees and houses behind it."""
    kind = str(builder.rng.choice(fences.GARDEN))
    _solid(builder, side, lot, kind, builder.between(1.2, 2.2))


def _noise_barrier(builder: Builder, side: Side, lot: Lot) -> None:
    """Set up a noise barrier, and trees and houses behind it."""
    kind = str(builder.rng.choice(list(fences.NOISE_BARRIERS)))
    _solid(builder, side, lot, kind, builder.between(2.0, 4.5))


def _solid(builder: Builder, side: Side, lot: Lot, kind: str, height: float) -> None:
    out = side.depth + builder.between(0.2, 1.5)
    shade = builder.between(0.6, 1.4)
    wall = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
    builder.put_line(wall, side, lot.start, lot.end, out)
    if builder.chance(0.4):
        ivy = partial(vegetation.ivy, builder.rng, height=height * builder.between(0.5, 1.1))
        low = builder.between(lot.start, (lot.start + lot.end) / 2)
        builder.put_line(ivy, side, low, builder.between(low, lot.end), out - 0.15)
    scatter(builder, side, lot, vegetation.tree, (5.0, 11.0), 3.0, reach=10)
    house_behind(builder, side, lot, side.depth + builder.between(3, 10))


def _forecourt(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a low house behind open ground with vehicles."""
    for s in np.arange(lot.start + 3, lot.end - 3, builder.between(4, 9)):
        mesh = (
            truck(builder.rng)
            if builder.chance(0.4)
            else vehicle(builder.rng, builder.plan.style.vehicles)
        )
        yaw = builder.between(0, 6.28)
        half = max(2.4, length_of(mesh) / 2)
        out = side.depth + builder.between(half, max(half + 0.1, lot.setback - half))
        builder.put_if_free(mesh, side, float(s), out, half, yaw)
    house_behind(builder, side, lot, side.depth + lot.setback)
    scatter(builder, side, lot, sizeless(pedestrians.bystander), (0, 1), 0.7)
    scatter(builder, side, lot, sizeless(furniture.clutter), (0, 1), 1.0)


def _carpark(builder: Builder, side: Side, lot: Lot) -> None:
    s = lot.start + 1.6
    yaw = float(builder.rng.choice([np.pi / 2, -np.pi / 2]))
    while s < lot.end - 1.2:
        if builder.chance(0.7):
            park(builder, side, s, side.depth + builder.between(2.6, 3.2), yaw, 1.1)
        s += builder.between(2.5, 2.8)
    close(builder, side, lot.start, lot.end, side.depth + lot.setback + 0.5)
    scatter(builder, side, lot, vegetation.tree, (4.0, 8.0), 1, reach=20)


def _background(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a second row of houses, or woods, behind a lot."""
    rng = builder.rng
    width = lot.end - lot.start
    out = side.depth + lot.setback + builder.between(20, 30)
    if builder.plan.half + out > REACH_M - 14:
        return
    if lot.kind not in ("field", "thicket") and width > 7 and builder.chance(0.4):
        mesh = buildings.house(rng, width * builder.between(0.7, 1), 10, int(rng.integers(2, 6)))
        builder.put(mesh, side, (lot.start + lot.end) / 2, out)
        for _ in builder.count(width / 12):
            tree = vegetation.tree(rng, builder.between(4, 10))
            s = builder.between(lot.start, lot.end)
            builder.put(tree, side, s, out - builder.between(2, 9))
    elif builder.chance(0.9):
        wood = partial(vegetation.thicket, rng, height=builder.between(4, 9), depth=4)
        builder.put_line(wood, side, lot.start, lot.end, out)


KINDS: dict[str, Callable[[Builder, Side, Lot], None]] = {
    "terrace": _terrace, "house": _house, "yard": _yard, "green": _green, "field": _field,
    "thicket": _thicket, "carpark": _carpark, "scrub": _scrub,
    "high_wall": _high_wall, "noise_barrier": _noise_barrier, "forecourt": _forecourt,
    "lawn": open_lots.lawn, "meadow": open_lots.meadow, "court": open_lots.court,
    "site": open_lots.site,
}  # fmt: skip
