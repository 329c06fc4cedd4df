# SPDX-License-Identifier: MIT
"""People who stand or sit about, and bicycles and motorcycles that wait for their riders."""

import numpy as np

from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things import cycles, furniture, people

TOWARDS_ROAD_RAD = -np.pi / 2
"""Turns what faces along the street towards the road."""
IN_A_ROW_M = 1.95
"""Distance between bicycles that stand one behind the other."""


def gather(builder: Builder, side: Side) -> None:
    """Fill the pavement with groups of people and with bicycles and motorcycles."""
    crowd = builder.plan.style.crowd * builder.plan.length / 100
    for _ in builder.count(0.13 * crowd):
        _group(builder, side, builder.along(), _distance_from_kerb(builder, side))
    for _ in builder.count(0.02 * crowd):
        _bench(builder, side, builder.along(), _distance_from_kerb(builder, side))
    for _ in builder.count(0.17 * crowd):
        _bicycles(builder, side, builder.along())
    for _ in builder.count(0.13 * crowd):
        _motorcycles(builder, side, builder.along())


def _distance_from_kerb(builder: Builder, side: Side) -> float:
    """Return a distance from the kerb, on the pavement: at the kerb, at the houses or between."""
    low, high = side.parking + 0.3, max(side.parking + 0.6, side.depth - 0.3)
    return (low, high, builder.between(low, high))[builder.rng.integers(3)]


def _group(builder: Builder, side: Side, s: float, out: float) -> None:
    """Stand one to eight people close together, some with a bicycle beside them."""
    count = int(builder.rng.choice([1, 1, 2, 2, 3, 4, 6, 8]))
    for _ in range(count):
        place = s + builder.rng.normal(0, 0.35 * count**0.5), out + builder.rng.normal(0, 0.35)
        yaw = builder.between(0, 6.28)
        builder.put_if_free(people.person(builder.rng), side, *place, 0.19, yaw)
        if builder.chance(0.12):
            bicycle = cycles.bicycle(builder.rng)
            builder.put_if_free(bicycle, side, place[0], place[1] + 0.5, 0.15, yaw * 0.05)


def _bench(builder: Builder, side: Side, s: float, out: float) -> None:
    """Seat people side by side on a bench."""
    if not builder.put_if_free(furniture.bench(builder.rng), side, s, out, 0.3):
        return
    for x in np.arange(-0.6, 0.9, builder.between(0.5, 0.8)):
        person = people.person(builder.rng, sitting=True)
        builder.put(person, side, s + float(x), out, TOWARDS_ROAD_RAD)


def _bicycles(builder: Builder, side: Side, s: float) -> None:
    """Lean bicycles off the road, one behind the other, or stand them side by side in a rack."""
    rack = builder.chance(0.4)
    out = max(0.5, side.depth - 0.3) if builder.chance(0.5) else _distance_from_kerb(builder, side)
    yaw = builder.between(-0.2, 0.2) + (np.pi / 2) * rack
    for step in range(int(builder.rng.choice([1, 1, 2, 5]))):
        backwards = builder.chance(0.4)
        turned = yaw + builder.rng.normal(0, 0.08) + np.pi * backwards
        lean = builder.rng.normal(0, 0.1) if rack else abs(builder.rng.normal(0.1, 0.1))
        mesh = cycles.bicycle(builder.rng).leaned(lean if backwards else -lean)
        place = s + step * (builder.between(0.45, 0.7) if rack else IN_A_ROW_M)
        builder.put_if_free(mesh, side, place, out, 0.22, turned)


def _motorcycles(builder: Builder, side: Side, s: float) -> None:
    """Park motorcycles at the kerb or on the pavement, along it or across."""
    at_kerb = builder.chance(0.4)
    out = builder.between(-0.7, -0.4) if at_kerb else _distance_from_kerb(builder, side)
    yaw = builder.rng.choice([0.0, np.pi / 2, 1.0]) + np.pi * builder.chance(0.5)
    out += 0.9 * abs(np.sin(yaw)) * at_kerb
    for step in range(int(builder.rng.choice([1, 1, 1, 2, 4]))):
        mesh = cycles.motorcycle(builder.rng).leaned(builder.rng.normal(0, 0.1))
        turned = yaw + builder.rng.normal(0, 0.1)
        builder.put_if_free(mesh, side, s + (0.9 + abs(np.cos(yaw))) * step, out, 0.35, turned)
