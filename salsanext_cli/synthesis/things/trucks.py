# SPDX-License-Identifier: MIT
"""Trucks: pickups, delivery vans with a box, lorries with box, flatbed, tub or tank, semi-trailers.

Local frame: x forward, y left, the middle of the footprint at the origin, the ground at z = 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, quads, tube
from salsanext_cli.synthesis.presets import CABS, TRUCKS
from salsanext_cli.synthesis.surfaces import TRUCK, Material
from salsanext_cli.synthesis.things.bodies import dark_paint, loft, wheels

STEEL = Skin(TRUCK, Material.METAL, 0.5)


class Bed(NamedTuple):
    """Half length, half width and height of the floor behind a cab, metres; skin of the load."""

    half_length: float
    half_width: float
    floor: float
    skin: Skin


def truck(rng: Rng) -> Mesh:
    """Return a truck of one of the kinds in the presets."""
    chances = np.array([kind["share"] for kind in TRUCKS.values()])
    kind = list(TRUCKS.values())[rng.choice(len(chances), p=chances / chances.sum())]
    shape = CABS[kind["cab"]]
    stretch = rng.uniform([0.85, 0.88, 0.85], [1.1, 1.08, 1.15])
    material = (Material.PLASTER, Material.PAINT, Material.METAL)[rng.integers(3)]
    load = Skin.drawn(rng, TRUCK, material, 0.5, 1.8)
    half_width = shape.width * 0.49 * stretch[1]
    bed = Bed(rng.uniform(*kind["bed"]) / 2, half_width, rng.uniform(*kind["floor"]), load)
    cab_length, gap = shape.length * stretch[0], rng.uniform(*kind["gap"])
    cab = loft(shape, TRUCK, dark_paint(rng) + 0.1, stretch)
    parts = [cab.moved((bed.half_length + cab_length / 2 + gap, 0, 0))]
    frame = bed.half_length + cab_length
    parts.append(box((-bed.half_length, -0.4, 0.5), (frame, 0.4, bed.floor), STEEL))
    parts += LOADS[kind["load"]](rng, bed)
    axles = [bed.half_length + gap + cab_length * 0.55, -bed.half_length * 0.62]
    if bed.half_length > 3:
        axles += [-bed.half_length * 0.62 + 1.15, -bed.half_length * 0.62 - 1.15]
    parts += wheels(TRUCK, axles, half_width, shape.wheel, 0.35)
    parts += _rear(rng, bed)
    return merge(parts).moved((-(cab_length + gap) / 2, 0, 0))


def _box(rng: Rng, bed: Bed) -> list[Mesh]:
    top = bed.floor + rng.uniform(1.7, 2.6)
    parts = [
        box(
            (-bed.half_length, -bed.half_width, bed.floor),
            (bed.half_length, bed.half_width, top),
            bed.skin,
        )
    ]
    for x in np.arange(-bed.half_length, bed.half_length, rng.uniform(0.6, 2.5)):
        low, high = (x, -bed.half_width - 0.02, bed.floor), (x + 0.05, bed.half_width + 0.02, top)
        parts.append(box(low, high, STEEL))
    if rng.random() < 0.3:
        wind = box(
            (bed.half_length, -bed.half_width * 0.8, top - 0.5),
            (bed.half_length + 0.6, bed.half_width * 0.8, top),
            bed.skin,
        )
        parts.append(wind)
    return parts


def _flat(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return a flatbed with low sides and things on it."""
    half_length, half_width, floor, skin = bed
    top = floor + rng.uniform(0.3, 1.0)
    parts = [
        box((-half_length, -half_width, floor), (half_length, half_width, floor + 0.08), skin),
        box((-half_length, -half_width, floor), (half_length, -half_width + 0.05, top), skin),
        box((-half_length, half_width - 0.05, floor), (half_length, half_width, top), skin),
        box((-half_length, -half_width, floor), (-half_length + 0.05, half_width, top), skin),
        box((half_length - 0.05, -half_width, floor), (half_length, half_width, top + 0.5), skin),
    ]
    for _ in range(int(rng.integers(0, 7))):
        largest = np.minimum([1.6, 1.0], [1.8 * half_length, 1.8 * half_width])
        size = rng.uniform([0.5, 0.4, 0.3], [*largest, 1.4])
        x, y = (
            rng.uniform(-half_length, half_length - size[0]),
            rng.uniform(-half_width, half_width - size[1]),
        )
        piece = Skin.drawn(rng, TRUCK, Material.WOOD, 0.3, 1.2)
        parts.append(box((x, y, floor + 0.1), (x + size[0], y + size[1], floor + size[2]), piece))
    return parts


def _tub(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return a tipper's tub, its sides sloping, perhaps full."""
    half_length, half_width, floor, skin = bed
    top, foot = floor + rng.uniform(0.8, 1.6), 0.8
    low = [[-half_length, -half_width * foot, floor], [half_length, -half_width * foot, floor]]
    low += [[half_length, half_width * foot, floor], [-half_length, half_width * foot, floor]]
    high = [[-half_length - 0.2, -half_width, top], [half_length + 0.2, -half_width, top + 0.2]]
    high += [[half_length + 0.2, half_width, top + 0.2], [-half_length - 0.2, half_width, top]]
    sides = [[low[i], low[i - 3], high[i - 3], high[i]] for i in range(4)]
    parts = [quads(np.array([low, *sides], float), skin)]
    for x in np.arange(-half_length, half_length, rng.uniform(0.5, 1.2)):
        parts.append(box((x, -half_width, floor + 0.1), (x + 0.08, half_width, top - 0.3), STEEL))
    return parts


def _tank(rng: Rng, bed: Bed) -> list[Mesh]:
    radius = float(min(bed.half_width, rng.uniform(0.8, 1.15)))
    x, z = bed.half_length, bed.floor + radius
    path = [[-x, 0, z], [-x + 0.15, 0, z], [x - 0.15, 0, z], [x, 0, z]]
    parts = [tube(path, radius * np.array([0.4, 1, 1, 0.4]), bed.skin, 14)]
    parts.append(box((-x * 0.7, -0.3, z + radius), (x * 0.7, 0.3, z + radius + 0.15), STEEL))
    return parts


LOADS: dict[str, Callable[[Rng, Bed], list[Mesh]]] = {
    "box": _box, "flat": _flat, "tub": _tub, "tank": _tank,
}  # fmt: skip


def _rear(rng: Rng, bed: Bed) -> list[Mesh]:
    """Return bumper and reflectors, perhaps a ramp, up or down."""
    rear, side = -bed.half_length, bed.half_width
    retro = Skin(TRUCK, Material.RETRO)
    parts = [box((rear - 0.02, -side, 0.42), (rear + 0.05, side, 0.52), STEEL)]
    for y in (-side + 0.1, side - 0.4):
        parts.append(box((rear - 0.03, y, 0.6), (rear + 0.01, y + 0.3, 0.75), retro))
    if rng.random() < 0.15:
        parts.append(box((rear - 0.12, -side, 0.5), (rear - 0.04, side, 2.1), STEEL))
    elif rng.random() < 0.08:
        low, high = [rear - 1.8, -side, 0.05], [rear, -side, bed.floor]
        ramp = np.array([[low, [low[0], side, 0.05], [rear, side, bed.floor], high]])
        parts.append(quads(ramp, STEEL))
    return parts
