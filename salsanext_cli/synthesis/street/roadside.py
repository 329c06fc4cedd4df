# SPDX-License-Identifier: MIT
"""Objects between the kerb and the lots, in the side streets and between the carriageways."""

import numpy as np

from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import ACROSS_M, Crossing, Side
from salsanext_cli.synthesis.things import fences, furniture, people, vegetation
from salsanext_cli.synthesis.things.pedestrians import bystander
from salsanext_cli.synthesis.things.vehicles import car, length_of, vehicle

TOWARDS_TRAFFIC_RAD = np.pi / 2
"""Yaw of a sign, which faces its local -y, towards the traffic on its side of the street."""
SIDE_STREET_END_M = 50.0  # Distance beyond the kerb at which trees close a side street
TOWARDS_ROAD_RAD = -np.pi / 2  # Yaw of objects that face the road


def furnish(builder: Builder, side: Side) -> None:
    """Fill the strips of one side: parked cars, trees, lamps, signs, people, clutter."""
    for fill in (_road_works, _islands, _parked, _trees, _lamps, _signs, _clutter):
        fill(builder, side)
    for crossing in side.crossings:
        _side_street(builder, side, crossing)


def _road_works(builder: Builder, side: Side) -> None:
    """Close off a stretch of the edge of the carriageway with a row of blocks."""
    if not builder.chance(builder.plan.style.works):
        return
    start = builder.along()
    end = min(start + builder.between(8, 50), builder.plan.length - 1)
    height = builder.between(0.75, 1.1)
    shade = builder.between(0.5, 1.5)
    length = builder.between(1, 4)
    gap = builder.between(0, 0.4)
    piece = fences.fence(builder.rng, length - gap, "block", height, shade)
    out = builder.between(-0.7, 0.5)
    for s in np.arange(start, end, length):
        builder.put_if_free(piece, side, float(s), out + builder.rng.normal(0, 0.04), 0.45 * length)


def _islands(builder: Builder, side: Side) -> None:
    """Plant the islands between groups of parking spaces."""
    for low, high in side.islands:
        half = (high - low) / 2
        room = side.parking / 2
        s = (low + high) / 2
        radius = min(half, room) * builder.between(0.6, 1)
        make = vegetation.bush if builder.chance(0.5) else vegetation.ground_cover
        planted = builder.put_if_free(make(builder.rng, radius), side, s, room, half)
        if planted and builder.chance(0.4):
            builder.put(vegetation.tree(builder.rng, builder.between(4, 10)), side, s, room)


def _parked(builder: Builder, side: Side) -> None:
    out = side.parking / 2 if side.parking else 0.75
    share = builder.plan.style.parked * (1 if side.parking else 0.45)
    s = 2.5
    occupied = builder.chance(share)
    across = side.parking > ACROSS_M
    while s < builder.plan.length - 2.5:
        if builder.chance(0.35):
            occupied = builder.chance(share)
        length = builder.between(2.4, 2.8) if across else 5.2
        if occupied and across:
            yaw = np.pi * (builder.chance(0.5) - 0.5) + builder.rng.normal(0, 0.03)
            beyond = out + builder.rng.normal(0, 0.15)
            builder.put_if_free(car(builder.rng), side, s + length / 2, beyond, 1.1, yaw)
        elif occupied:
            mesh = vehicle(builder.rng, builder.plan.style.vehicles)
            length = length_of(mesh) + builder.between(0.6, 1.6)
            yaw = np.pi * (builder.chance(0.15) ^ (side.sign > 0)) + builder.rng.normal(0, 0.02)
            beyond = out + (0.2 if length > 7 else 0.0) + builder.rng.normal(0, 0.08)
            facing = yaw + (0 if side.sign > 0 else np.pi)
            builder.put_if_free(mesh, side, s + length / 2, beyond, length / 2 - 0.35, facing)
        s += length


def _trees(builder: Builder, side: Side) -> None:
    if not side.verge and builder.chance(0.5):
        return
    out = side.parking + side.verge / 2 if side.verge else side.parking + 0.7
    s = builder.between(2, 10)
    height = builder.between(8, 16) if builder.chance(0.4) else builder.between(4.5, 12)
    while s < builder.plan.length:
        mesh = vegetation.tree(builder.rng, height * builder.between(0.85, 1.15))
        builder.put_if_free(mesh, side, s, out + builder.rng.normal(0, 0.1), 0.5)
        if side.verge and builder.chance(0.7):
            make = vegetation.weeds if builder.chance(0.4) else vegetation.ground_cover
            plants = make(builder.rng, builder.between(0.3, 0.8))
            builder.put(plants, side, s + builder.between(1, 4), out)
        s += builder.between(*builder.plan.style.tree_gap)
    if side.verge and builder.chance(0.3):
        for s in np.arange(3, builder.plan.length, builder.between(2, 8)):
            radius = min(1.0, 0.5 * side.verge) * builder.between(0.2, 1)
            builder.put_if_free(vegetation.bush(builder.rng, radius), side, float(s), out, 0.8)


def _lamps(builder: Builder, side: Side) -> None:
    s = builder.between(0, 25)
    kind = furniture.lamp(builder.rng)
    while s < builder.plan.length:
        builder.put_if_free(kind, side, s, side.parking + builder.between(0.35, 0.5), 0.3)
        s += builder.between(26, 50)
    for _ in builder.count(builder.plan.length / 80):
        s = builder.along()
        out = side.parking + builder.between(0.3, 0.5)
        for step in range(int(builder.rng.choice([1, 1, 1, 3, 5]))):
            builder.put_if_free(furniture.post(builder.rng), side, s + 1.5 * step, out, 0.3)


def _signs(builder: Builder, side: Side) -> None:
    """Set up signs, mostly facing the traffic on their side, and traffic lights."""
    for _ in builder.count(builder.plan.length / 40):
        s = builder.along()
        make = furniture.board if builder.chance(0.22) else furniture.sign
        yaw = builder.rng.choice([1, 1, 1, -1, 0]) * TOWARDS_TRAFFIC_RAD
        out = side.parking + builder.between(0.4, 1.3)
        builder.put_if_free(make(builder.rng), side, s, out, 0.4, yaw + builder.rng.normal(0, 0.2))
    for crossing in builder.plan.crossings:
        reach = crossing.half + 0.5 * crossing.corner + builder.between(0.4, 2.0)
        for s in (crossing.s - reach, crossing.s + reach):
            if builder.chance(0.45):
                make = furniture.traffic_light if builder.chance(0.3) else furniture.sign
                yaw = -TOWARDS_TRAFFIC_RAD * builder.rng.choice([1, -1])
                out = side.parking + 0.5 + 0.2 * crossing.corner
                builder.put_if_free(make(builder.rng), side, s, out, 0.3, yaw)


def _clutter(builder: Builder, side: Side) -> None:
    for _ in builder.count(builder.plan.length / 18):
        s = builder.along()
        edge = side.depth - 0.4 if builder.chance(0.6) else side.parking + 0.6
        builder.put_if_free(furniture.clutter(builder.rng), side, s, max(edge, 0.6), 0.7)
    if side.sidewalk > 2 and builder.chance(0.4):
        s = builder.along()
        builder.put_if_free(furniture.shelter(builder.rng), side, s, side.depth - 1.6, 2.0)


def _park_along(builder: Builder, side: Side, crossing: Crossing) -> None:
    """Park vehicles one behind the other at either edge of a side street."""
    edge = crossing.half - 0.9
    out = builder.between(8, 14)
    while out < SIDE_STREET_END_M:
        if builder.chance(0.6):
            out += builder.between(5.5, 9)
            continue
        mesh = vehicle(builder.rng, builder.plan.style.vehicles)
        end = out + length_of(mesh)
        if end < SIDE_STREET_END_M:
            s = crossing.s + edge * builder.rng.choice([-1, 1])
            rear = float(mesh.vertices[:, 0].min())
            builder.put(mesh, side, s, out - rear, yaw=np.pi / 2)
        out = end + builder.between(0.8, 3)


def _side_street(builder: Builder, side: Side, crossing: Crossing) -> None:
    _park_along(builder, side, crossing)
    if builder.chance(0.5):
        s = crossing.s - side.sign * crossing.half * 0.45
        builder.put(car(builder.rng), side, s, builder.between(2.6, 5), TOWARDS_ROAD_RAD)
    for _ in builder.count(2 if crossing.pavement else 0.5):
        away = (crossing.half + builder.between(0.4, 1.4)) * builder.rng.choice([-1, 1])
        makers = (bystander, bystander, furniture.post, people.bicycle, furniture.sign)
        mesh = makers[builder.rng.integers(5)](builder.rng)
        out = side.depth + builder.between(0, 25)
        builder.put(mesh, side, crossing.s + away, out, builder.between(0, 6.28))
    wide = 2 * crossing.half + 6
    wood = vegetation.thicket(builder.rng, wide, 3, builder.between(4, 8))
    builder.put(wood.moved((-wide / 2, 0, 0)), side, crossing.s, SIDE_STREET_END_M)
