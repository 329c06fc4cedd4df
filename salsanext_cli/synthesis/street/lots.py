# SPDX-License-Identifier: MIT
"""Objects on the lots beside the street, and their fences, walls and hedges."""

from collections.abc import Callable
from functools import partial

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng
from salsanext_cli.synthesis.street.builder import Builder, Maker
from salsanext_cli.synthesis.street.plan import REACH_M, Lot, Side
from salsanext_cli.synthesis.things import buildings, furniture, people, vegetation
from salsanext_cli.synthesis.things.vehicles import car, length_of, truck, vehicle

CAR_ROOM_M = 5.2  # Distance from the kerb to the house that a car in the driveway needs
SOLID_M = 1.1  # Height of walls around a lot; higher ones are rarely labelled fence
Span = tuple[float, float]
Sized = Callable[[Rng, float], Mesh]  # Returns an object of a size in metres


def furnish(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a lot and its background."""
    KINDS[lot.kind](builder, side, lot)
    _background(builder, side, lot)


def _terrace(builder: Builder, side: Side, lot: Lot) -> None:
    width, rng = lot.end - lot.start, builder.rng
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
        _close(builder, side, lot.start, lot.end, side.depth + 0.2, open_chance=0.3)
    _plant(builder, side, lot, lot.setback / 3)


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
    width, rng = lot.end - lot.start, builder.rng
    front = side.depth + lot.setback
    gap = builder.between(2.5, 6)
    drive = lot.drive[1] - lot.drive[0]
    if drive and builder.chance(0.55) and front > CAR_ROOM_M:
        _park(builder, side, sum(lot.drive) / 2, front - min(2.6, lot.setback / 2), np.pi / 2, 2.0)
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
            _close(builder, side, lot.start, lot.start + gap, front + 1)
    gate = lot.start if drive else builder.between(lot.start + 1, lot.end - 2)
    gate_end = lot.drive[1] if drive else gate + 1.2
    for start, end in ((lot.start, gate), (gate_end, lot.end)):
        _close(builder, side, start, end, side.depth + builder.between(0.1, 0.4))
    _plant(builder, side, lot, lot.setback * width / 18)
    if builder.chance(0.75) and lot.setback > 2:
        kind = vegetation.tree if builder.chance(0.7) else vegetation.conifer
        _scatter(builder, side, lot, kind, (3.0, 8.0), 1.2)
    if builder.chance(0.5):
        end = front + builder.between(2, 12)
        builder.put_outward(_boundary(builder), side, lot.end, side.depth + 0.3, end)
    _scatter(builder, side, lot, _sizeless(furniture.clutter), (0, 1), 0.8)
    _scatter(builder, side, lot, _sizeless(people.motorcycle), (0, 1), 0.12)


def _yard(builder: Builder, side: Side, lot: Lot) -> None:
    _close(builder, side, lot.start, lot.end, side.depth + 0.25, open_chance=0.0)
    _scatter(builder, side, lot, vegetation.tree, (4.0, 9.0), 1.5, reach=15)
    _plant(builder, side, lot, 4, reach=12)
    _scatter(builder, side, lot, _sizeless(furniture.clutter), (0, 1), 1.5, reach=8)
    if builder.chance(0.35):
        _park(builder, side, builder.between(lot.start + 2, lot.end - 2), side.depth + 5, 0.3, 2.0)
    if builder.chance(0.5) and lot.end - lot.start > 8:
        garage, middle = buildings.garage(builder.rng), (lot.start + lot.end) / 2
        builder.put(garage, side, middle, side.depth + builder.between(4, 12))


def _green(builder: Builder, side: Side, lot: Lot) -> None:
    area = (lot.end - lot.start) / 8
    _scatter(builder, side, lot, vegetation.tree, (4.0, 11.0), 2.0 * area, reach=25)
    _scatter(builder, side, lot, vegetation.conifer, (3.0, 9.0), 0.5 * area, reach=25)
    _plant(builder, side, lot, 3.0 * area, reach=20)
    _scatter(builder, side, lot, vegetation.weeds, (0.5, 1.6), 2.0 * area, reach=15)
    _scatter(builder, side, lot, _sizeless(people.person), (0, 1), 0.5 * area, reach=12)
    _scatter(builder, side, lot, _sizeless(furniture.clutter), (0, 1), 0.5 * area, reach=6)


def _field(builder: Builder, side: Side, lot: Lot) -> None:
    area = (lot.end - lot.start) / 8
    _scatter(builder, side, lot, vegetation.bush, (0.4, 2.0), 0.9 * area, reach=30)
    _scatter(builder, side, lot, vegetation.tree, (4.0, 11.0), 0.5 * area, reach=40)
    _scatter(builder, side, lot, vegetation.weeds, (0.6, 2.0), 4.0 * area, reach=15)
    is_barrier = builder.chance(0.3)
    if is_barrier or builder.chance(0.25):
        kind, out = ("barrier", 0.8) if is_barrier else ("mesh", 3.0)
        shade, height = builder.between(0.7, 1.4), builder.between(0.9, 1.3)
        fence = partial(buildings.fence, builder.rng, kind=kind, height=height, shade=shade)
        builder.put_line(fence, side, lot.start, lot.end, side.depth + out)


def _thicket(builder: Builder, side: Side, lot: Lot) -> None:
    undergrowth = _undergrowth(builder, (2.5, 7), (3, 8))
    if builder.chance(0.5):
        _close(builder, side, lot.start, lot.end, side.depth + 0.2, open_chance=0.3)
    out = side.depth + builder.between(0.8, 4)
    builder.put_line(undergrowth, side, lot.start, lot.end, out)
    if builder.chance(0.2):
        _house_behind(builder, side, lot, out + builder.between(6, 16))


def _scrub(builder: Builder, side: Side, lot: Lot) -> None:
    out = side.depth + builder.between(0.3, 1.5)
    scrub = _hedge(builder) if builder.chance(0.55) else _undergrowth(builder, (1.5, 5), (1.5, 4))
    builder.put_line(scrub, side, lot.start, lot.end, out + 0.4)
    _scatter(builder, side, lot, vegetation.tree, (4.0, 10.0), 2.0, reach=12)
    _house_behind(builder, side, lot, out + builder.between(4, 14))


def _house_behind(builder: Builder, side: Side, lot: Lot, out: float) -> None:
    width = lot.end - lot.start
    if width > 7 and builder.chance(0.8):
        floors = int(builder.rng.integers(1, 4))
        mesh = buildings.house(builder.rng, width * builder.between(0.6, 0.95), 10, floors)
        builder.put(mesh, side, (lot.start + lot.end) / 2, out)


def _high_wall(builder: Builder, side: Side, lot: Lot) -> None:
    """Set up a wall, as high as a noise barrier beside a motorway, and trees and houses."""
    out = side.depth + 0.3
    kind = "wall" if builder.chance(0.6) else "boards"
    heights = (1.5, 3.5) if builder.plan.style.barrier else (1.0, 1.9)
    height, shade = builder.between(*heights), builder.between(0.6, 1.4)
    wall = partial(buildings.fence, builder.rng, kind=kind, height=height, shade=shade)
    builder.put_line(wall, side, lot.start, lot.end, out)
    if builder.chance(0.4):
        ivy = partial(vegetation.ivy, builder.rng, height=height * builder.between(0.5, 1.1))
        low = builder.between(lot.start, (lot.start + lot.end) / 2)
        builder.put_line(ivy, side, low, builder.between(low, lot.end), out - 0.15)
    _scatter(builder, side, lot, vegetation.tree, (5.0, 11.0), 3.0, reach=10)
    _house_behind(builder, side, lot, side.depth + builder.between(3, 10))


def _forecourt(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a low house behind open ground with vehicles."""
    for s in np.arange(lot.start + 3, lot.end - 3, builder.between(4, 9)):
        mesh = truck(builder.rng) if builder.chance(0.4) else vehicle(builder.rng)
        yaw = builder.between(0, 6.28)
        half = max(2.4, length_of(mesh) / 2)
        out = side.depth + builder.between(half, max(half + 0.1, lot.setback - half))
        builder.put_if_free(mesh, side, float(s), out, half, yaw)
    _house_behind(builder, side, lot, side.depth + lot.setback)
    _scatter(builder, side, lot, _sizeless(people.person), (0, 1), 0.7)
    _scatter(builder, side, lot, _sizeless(furniture.clutter), (0, 1), 1.0)


def _carpark(builder: Builder, side: Side, lot: Lot) -> None:
    s = lot.start + 1.6
    yaw = float(builder.rng.choice([np.pi / 2, -np.pi / 2]))
    while s < lot.end - 1.2:
        if builder.chance(0.7):
            _park(builder, side, s, side.depth + builder.between(2.6, 3.2), yaw, 1.1)
        s += builder.between(2.5, 2.8)
    _close(builder, side, lot.start, lot.end, side.depth + lot.setback + 0.5)
    _scatter(builder, side, lot, vegetation.tree, (4.0, 8.0), 1, reach=20)


def _park(builder: Builder, side: Side, s: float, out: float, yaw: float, radius: float) -> None:
    """Place a parked car in either direction."""
    turned = yaw + np.pi * builder.chance(0.5) + builder.rng.normal(0, 0.03)
    builder.put_if_free(car(builder.rng), side, s, out, radius, turned)


def _scatter(
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


def _plant(builder: Builder, side: Side, lot: Lot, count: float, reach: float = 0) -> None:
    """Scatter low and high bushes and ground cover."""
    for make, size, share in PLANTS:
        _scatter(builder, side, lot, make, size, share * count, reach)


def _sizeless(make: Callable[[Rng], Mesh]) -> Sized:
    return lambda rng, _size: make(rng)


def _background(builder: Builder, side: Side, lot: Lot) -> None:
    """Build a second row of houses, or woods, behind a lot."""
    rng, width = builder.rng, lot.end - lot.start
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


def _boundary(builder: Builder) -> Maker:
    """Return a maker of pieces of a hedge, a fence or a wall."""
    if builder.chance(0.4):
        return _hedge(builder)
    kind = str(builder.rng.choice(buildings.FENCES))
    if kind in ("wall", "boards"):
        height = builder.between(0.3, SOLID_M)
    else:
        height = builder.between(*(1.1, 2.2) if builder.chance(0.25) else (0.5, 1.1))
    shade = builder.between(0.7, 1.5)
    return partial(buildings.fence, builder.rng, kind=kind, height=height, shade=shade)


def _hedge(builder: Builder) -> Maker:
    low = builder.chance(0.6)
    height = builder.between(*(0.4, 1.2) if low else (0.7, 2.7))
    depth = builder.between(0.4, 1.0 if low else 1.5)
    clipped = builder.chance(0.75 if low else 0.5)
    ragged = builder.between(*(0.003, vegetation.CLIPPED_M) if clipped else (0.03, 0.2))
    return partial(vegetation.hedge, builder.rng, height=height, depth=depth, ragged=ragged)


def _undergrowth(builder: Builder, heights: Span, depths: Span) -> Maker:
    height, depth = builder.between(*heights), builder.between(*depths)
    return partial(vegetation.thicket, builder.rng, depth=depth, height=height)


def _close(
    builder: Builder, side: Side, start: float, end: float, out: float, open_chance: float = 0.1
) -> None:
    """Fence a lot off towards the street, perhaps with bushes, or leave it open."""
    if builder.chance(open_chance) or end - start < 0.5:
        return
    builder.put_line(_boundary(builder), side, start, end, out)
    if builder.chance(0.6):
        bushes = _undergrowth(builder, (1.2, 4.0), (0.8, 1.6))
        builder.put_line(bushes, side, start, end, out + builder.between(0.3, 0.9))


PLANTS = (
    (vegetation.bush, (0.12, 0.45), 0.5),
    (vegetation.bush, (0.4, 1.3), 0.5),
    (vegetation.ground_cover, (0.4, 1.8), 0.35),
)
"""Makers, sizes and relative numbers of the plants of a lot."""
KINDS: dict[str, Callable[[Builder, Side, Lot], None]] = {
    "terrace": _terrace, "house": _house, "yard": _yard, "green": _green, "field": _field,
    "thicket": _thicket, "carpark": _carpark, "scrub": _scrub,
    "high_wall": _high_wall, "forecourt": _forecourt,
}  # fmt: skip
