# SPDX-License-Identifier: MIT
"""People who stay at the roadside, halting riders, and parked bicycles and motorcycles."""

import numpy as np

from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things import furniture, pedestrians, people, riders, vegetation

TOWARDS_ROAD_RAD = -np.pi / 2  # Yaw of objects that face the road
IN_A_ROW_M = 1.95  # Distance between bicycles in a row
RACK_GAP_M = 0.75  # Distance between the hoops of a rack


def furnish(builder: Builder, side: Side) -> None:
    """Place people who stand, sit or halt beside one side of the street, and their vehicles."""
    crowd = builder.plan.style.crowd * builder.plan.length / 100
    for _ in builder.count(0.13 * crowd):
        _group(builder, side, builder.along(), _distance_from_kerb(builder, side))
    for _ in builder.count(0.02 * crowd):
        _bench(builder, side, builder.along(), _distance_from_kerb(builder, side))
    for _ in builder.count(0.17 * crowd):
        _bicycles(builder, side, builder.along())
    for _ in builder.count(0.13 * crowd):
        _motorcycles(builder, side, builder.along())
    for _ in builder.count(0.03 * crowd):
        _people_at_a_pole(builder, side, builder.along())
    for _ in builder.count(0.03 * crowd):
        _between_cars(builder, side, builder.along())
    for _ in builder.count(0.02 * crowd):
        _rack(builder, side, builder.along())
    for _ in builder.count(0.04 * builder.plan.style.riders * builder.plan.length / 100):
        _halting_rider(builder, side)
    for crossing in side.crossings:
        for _ in builder.count(0.02 * builder.plan.style.crowd):
            corner = crossing.half + builder.between(0.5, 4.0)
            s = crossing.s + corner * builder.rng.choice([-1, 1])
            _group(builder, side, s, side.parking + builder.between(0.2, 1.0))


def _distance_from_kerb(builder: Builder, side: Side) -> float:
    """Return a distance from the kerb, on the pavement: at the kerb, at the houses or between."""
    low = side.parking + 0.3
    high = max(side.parking + 0.6, side.depth - 0.3)
    return (low, high, builder.between(low, high))[builder.rng.integers(3)]


def _group(builder: Builder, side: Side, s: float, out: float) -> None:
    count = int(builder.rng.choice([1, 1, 2, 2, 3, 4, 6, 8]))
    for _ in range(count):
        place = s + builder.rng.normal(0, 0.35 * count**0.5), out + builder.rng.normal(0, 0.35)
        yaw = builder.between(0, 6.28)
        builder.put_if_free(builder.model(pedestrians.bystander), side, *place, 0.19, yaw)


def _bench(builder: Builder, side: Side, s: float, out: float) -> None:
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
        mesh = builder.model(people.bicycle).leaned(lean if backwards else -lean)
        place = s + step * (builder.between(0.45, 0.7) if rack else IN_A_ROW_M)
        builder.put_if_free(mesh, side, place, out, 0.22, turned)


def _motorcycles(builder: Builder, side: Side, s: float) -> None:
    at_kerb = builder.chance(0.4)
    out = builder.between(-0.7, -0.4) if at_kerb else _distance_from_kerb(builder, side)
    yaw = builder.rng.choice([0.0, np.pi / 2, 1.0]) + np.pi * builder.chance(0.5)
    out += 0.9 * abs(np.sin(yaw)) * at_kerb
    for step in range(int(builder.rng.choice([1, 1, 1, 2, 4]))):
        mesh = builder.model(people.motorcycle).leaned(builder.rng.normal(0, 0.1))
        turned = yaw + builder.rng.normal(0, 0.1)
        builder.put_if_free(mesh, side, s + (0.9 + abs(np.cos(yaw))) * step, out, 0.35, turned)


def _people_at_a_pole(builder: Builder, side: Side, s: float) -> None:
    """Let people stand at a post, a lamp, a sign or a young tree, near enough to hide it."""
    makers = (furniture.post, furniture.lamp, furniture.sign)
    out = side.parking + builder.between(0.35, 1.0)
    if builder.chance(0.5):
        upright = vegetation.tree(builder.rng, builder.between(4, 9))
    else:
        upright = makers[builder.rng.integers(3)](builder.rng)
    if not builder.put_if_free(upright, side, s, out, 0.1):
        return
    for _ in range(int(builder.rng.choice([1, 1, 1, 2, 3]))):
        angle = builder.between(0, 2 * np.pi)
        away = builder.between(0.35, 1.1)
        place = s + away * np.cos(angle), out + away * np.sin(angle)
        person = builder.model(pedestrians.bystander)
        builder.put_if_free(person, side, *place, 0.19, builder.between(0, 2 * np.pi))


def _between_cars(builder: Builder, side: Side, s: float) -> None:
    """Let somebody stand beside or between parked cars, if there is a gap."""
    beyond = builder.between(-0.6, max(1.5, side.parking))
    for step in np.arange(0, 4, 0.5):
        person = builder.model(pedestrians.bystander)
        if builder.put_if_free(person, side, s + float(step), beyond, 0.19, builder.between(0, 6)):
            return


def _halting_rider(builder: Builder, side: Side) -> None:
    """Let a rider wait at the kerb, on the pavement, or at a side street."""
    out = -builder.between(0.2, 0.7) if builder.chance(0.4) else _distance_from_kerb(builder, side)
    yaw = np.pi * builder.chance(0.5) + builder.rng.normal(0, 0.3)
    builder.put_if_free(builder.model(riders.halting_rider), side, builder.along(), out, 0.6, yaw)


def _rack(builder: Builder, side: Side, s: float) -> None:
    """Stand bicycles at both sides of the hoops of a rack across the pavement."""
    out = side.parking + builder.between(1.0, max(1.1, side.verge + side.sidewalk - 1.0))
    for step in range(int(builder.rng.integers(2, 8))):
        place = s + RACK_GAP_M * step
        builder.put_if_free(furniture.hoop(builder.rng), side, place, out, 0.05, np.pi / 2)
        for away in (-0.2, 0.2):
            if builder.chance(0.6):
                yaw = np.pi * (builder.chance(0.5) - 0.5) + builder.rng.normal(0, 0.05)
                bicycle = builder.model(people.bicycle).leaned(builder.rng.normal(0, 0.06))
                aside = out + builder.rng.normal(0, 0.1)
                builder.put_if_free(bicycle, side, place + away, aside, 0.12, yaw)
