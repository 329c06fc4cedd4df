# SPDX-License-Identifier: MIT
"""Buses and other vehicles: caravans, trailers, tractors, excavators.

Local frame: x forward, y left, the middle of the footprint at the origin, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, tube
from salsanext_cli.synthesis.presets import BUS, CARAVAN
from salsanext_cli.synthesis.surfaces import BUS as BUS_ID
from salsanext_cli.synthesis.surfaces import OTHER_VEHICLE, Material
from salsanext_cli.synthesis.things.bodies import dark_paint, fittings, loft, wheels

DARK = Skin(OTHER_VEHICLE, Material.RUBBER)
IRON = Skin(OTHER_VEHICLE, Material.METAL, 0.6)


def bus(rng: Rng) -> Mesh:
    """Return a bus, from a minibus to one of 12 m and more."""
    stretch = rng.uniform([0.55, 0.88, 0.85], [1.1, 1.02, 1.08])
    length, width = BUS.length * stretch[0], BUS.width * stretch[1]
    paint = dark_paint(rng) if rng.random() < 0.5 else float(rng.uniform(0.3, 1.6))
    axles = [0.28 * length, -0.26 * length]
    parts = [loft(BUS, BUS_ID, paint, stretch), *fittings(BUS, BUS_ID, stretch)]
    parts += wheels(BUS_ID, axles, width / 2, BUS.wheel, 0.3)
    top = BUS.profile[:, 2].max() * stretch[2]
    if rng.random() < 0.6:
        skin = Skin(BUS_ID, Material.PAINT, paint)
        parts.append(box((-length / 4, -0.7, top), (length / 5, 0.7, top + 0.3), skin))
    pillar = Skin(BUS_ID, Material.PAINT, paint)
    for x in np.arange(-0.4, 0.4, rng.uniform(0.1, 0.16)) * length:
        low, high = (x, -width / 2, 1.2 * stretch[2]), (x + 0.12, width / 2, top - 0.1)
        parts.append(box(low, high, pillar))
    return merge(parts)


def _caravan(rng: Rng) -> Mesh:
    stretch = rng.uniform([0.7, 0.85, 0.8], [1.25, 1.08, 1.06])
    half = CARAVAN.width / 2 * stretch[1]
    front = CARAVAN.length / 2 * stretch[0]
    return merge([
        loft(CARAVAN, OTHER_VEHICLE, float(rng.uniform(0.1, 1.6)), stretch),
        *wheels(OTHER_VEHICLE, [rng.uniform(-0.5, 0.2)], half, CARAVAN.wheel, 0.2),
        *_drawbar(front),
    ])  # fmt: skip


def _drawbar(front: float) -> list[Mesh]:
    bar = tube([[front - 0.3, 0, 0.45], [front + 1.2, 0, 0.42]], 0.05, IRON)
    return [bar, tube([[front + 1.0, 0, 0.0], [front + 1.0, 0, 0.5]], 0.04, IRON)]


def _trailer(rng: Rng) -> Mesh:
    """Return a small trailer: open, with a tarpaulin, or a closed box."""
    x, y, floor = rng.uniform([0.9, 0.6, 0.45], [2.6, 1.05, 0.65])
    height = rng.choice([rng.uniform(0.3, 0.5), rng.uniform(0.8, 1.9)])
    skin = Skin.drawn(
        rng, OTHER_VEHICLE, Material.CLOTH if height > 0.6 else Material.METAL, 0.2, 1.4
    )
    parts = [box((-x, -y, floor), (x, y, floor + height), skin)]
    parts += wheels(OTHER_VEHICLE, [0.0, -0.7] if x > 2 else [0.0], y + 0.2, 0.3, 0.18)
    return merge([*parts, *_drawbar(float(x))])


def _tractor(rng: Rng) -> Mesh:
    paint = Skin(OTHER_VEHICLE, Material.PAINT, float(rng.uniform(0.1, 1.4)))
    glass = Skin(OTHER_VEHICLE, Material.GLASS)
    parts = [
        box((0.2, -0.4, 0.8), (2.0, 0.4, 1.55), paint),
        box((-1.0, -0.75, 0.9), (0.2, 0.75, 1.4), paint),
        box((-1.0, -0.7, 1.4), (0.2, 0.7, 2.5), glass),
        box((-1.1, -0.8, 2.5), (0.3, 0.8, 2.7), paint),
        *wheels(OTHER_VEHICLE, [-0.7], 1.05, 0.8, 0.45),
        *wheels(OTHER_VEHICLE, [1.5], 0.95, 0.55, 0.35),
        tube([[0.5, -0.45, 1.5], [0.5, -0.45, 2.7]], 0.05, IRON),
    ]
    for x, y in ((-1.0, -0.72), (-1.0, 0.66), (0.15, -0.72), (0.15, 0.66)):
        parts.append(box((x, y, 1.4), (x + 0.08, y + 0.08, 2.5), paint))
    return merge(parts).scaled(rng.uniform(0.8, 1.15))


def _excavator(rng: Rng) -> Mesh:
    paint = Skin(OTHER_VEHICLE, Material.PAINT, float(rng.uniform(0.4, 1.5)))
    parts = [box((-1.6, y - 0.25, 0), (1.6, y + 0.25, 0.8), DARK) for y in (-0.95, 0.95)]
    upper = [
        box((-1.7, -1.2, 1.0), (0.9, 1.2, 1.9), paint),
        box((-0.3, 0.2, 1.9), (0.9, 1.15, 2.8), Skin(OTHER_VEHICLE, Material.GLASS)),
        box((-0.4, 0.15, 2.8), (1.0, 1.2, 2.9), paint),
    ]
    reach, lift = rng.uniform([2.2, 2.5], [3.6, 4.2])
    joint, tip = [reach, -0.3, lift], [reach + rng.uniform(0.6, 1.6), -0.3, rng.uniform(0.4, 1.5)]
    upper += [tube([[0.5, -0.3, 1.6], joint], 0.22, paint), tube([joint, tip], 0.17, paint)]
    upper.append(box(np.array(tip) - [0.5, 0.5, 0.4], np.array(tip) + [0.3, 0.5, 0.4], IRON))
    parts.append(merge(upper).moved(yaw=rng.uniform(-0.2, 0.2)))
    return merge(parts).scaled(rng.uniform(0.6, 1.1))


def other_vehicle(rng: Rng) -> Mesh:
    """Return a caravan, a trailer, a tractor or an excavator."""
    makers = (_caravan, _caravan, _trailer, _trailer, _tractor, _excavator)
    return makers[rng.integers(len(makers))](rng)
