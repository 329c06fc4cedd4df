# SPDX-License-Identifier: MIT
"""Caravans, trailers, tractors and vehicles of building sites."""

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, tube
from salsanext_cli.synthesis.presets import OTHER_VEHICLE, Material
from salsanext_cli.synthesis.things import site_vehicles
from salsanext_cli.synthesis.things.bodywork import shell, wheels

IRON = Skin(OTHER_VEHICLE, Material.METAL, 0.6)


def _caravan(rng: Rng) -> Mesh:
    shape = presets.CARAVAN_BODY
    stretch = rng.uniform([0.7, 0.85, 0.8], [1.25, 1.08, 1.06])
    half = shape.width / 2 * stretch[1]
    front = shape.length / 2 * stretch[0]
    parts = [shell(shape, Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.1, 1.6), stretch)]
    parts += wheels(OTHER_VEHICLE, [rng.uniform(-0.5, 0.2)], half, shape.wheel, 0.2)
    return merge([*parts, *_drawbar(front)])


def _drawbar(front: float) -> list[Mesh]:
    bar = tube([[front - 0.3, 0, 0.45], [front + 1.2, 0, 0.42]], 0.05, IRON)
    return [bar, tube([[front + 1.0, 0, 0.0], [front + 1.0, 0, 0.5]], 0.04, IRON)]


def _trailer(rng: Rng) -> Mesh:
    """Return a small trailer: open, with a tarpaulin, or a closed box."""
    x, y, floor = rng.uniform([0.9, 0.6, 0.45], [2.6, 1.05, 0.65])
    height = rng.choice([rng.uniform(0.3, 0.5), rng.uniform(0.8, 1.9)])
    material = Material.CLOTH if height > 0.6 else Material.METAL
    skin = Skin.random(rng, OTHER_VEHICLE, material, 0.2, 1.4)
    parts = [box((-x, -y, floor), (x, y, floor + height), skin)]
    parts += wheels(OTHER_VEHICLE, [0.0, -0.7] if x > 2 else [0.0], y + 0.2, 0.3, 0.18)
    return merge([*parts, *_drawbar(float(x))])


def _tractor(rng: Rng) -> Mesh:
    paint = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.1, 1.4)
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
    paint = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.4, 1.5)
    tracks = Skin(OTHER_VEHICLE, Material.RUBBER)
    parts = [box((-1.6, y - 0.25, 0), (1.6, y + 0.25, 0.8), tracks) for y in (-0.95, 0.95)]
    upper = [
        box((-1.7, -1.2, 1.0), (0.9, 1.2, 1.9), paint),
        box((-0.3, 0.2, 1.9), (0.9, 1.15, 2.8), Skin(OTHER_VEHICLE, Material.GLASS)),
        box((-0.4, 0.15, 2.8), (1.0, 1.2, 2.9), paint),
    ]
    reach, lift = rng.uniform([2.2, 2.5], [3.6, 4.2])
    joint = [reach, -0.3, lift]
    tip = [reach + rng.uniform(0.6, 1.6), -0.3, rng.uniform(0.4, 1.5)]
    upper += [tube([[0.5, -0.3, 1.6], joint], 0.22, paint), tube([joint, tip], 0.17, paint)]
    upper.append(box(np.array(tip) - [0.5, 0.5, 0.4], np.array(tip) + [0.3, 0.5, 0.4], IRON))
    parts.append(merge(upper).moved(yaw=rng.uniform(-0.2, 0.2)))
    return merge(parts).scaled(rng.uniform(0.6, 1.1))


def other_vehicle(rng: Rng) -> Mesh:
    """Return a caravan, a motorhome, a trailer, a farm tractor or a site vehicle."""
    makers = (
        *[_caravan] * 3, _motorhome, *[_trailer] * 3, _farm_trailer, _boat_trailer,
        *[_tractor] * 2, *[_excavator] * 2, *[site_vehicles.site_vehicle] * 3,
    )  # fmt: skip
    return makers[rng.integers(len(makers))](rng)


def _motorhome(rng: Rng) -> Mesh:
    """Return a motorhome: a van's front below the overhang of a high box."""
    length = rng.uniform(5.5, 7.0)
    half = rng.uniform(1.0, 1.15)
    paint = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.3, 1.6)
    cab = presets.TRUCKS["van"].cab
    overhang = rng.uniform(0.3, 1.3)
    rear = -length / 2
    step = length / 2 - cab.length * 0.75
    top = rng.uniform(2.6, 3.0)
    glass = Skin(OTHER_VEHICLE, Material.GLASS)
    skin = paint._replace(shade=paint.shade * 0.9)
    parts = [
        shell(cab, skin, np.array([1.0, 1.0, 0.95])).moved((length / 2 - cab.length / 2, 0, 0)),
        box((rear, -half, 0.45), (step, half, top), paint),
        box((step, -half * 0.95, 2.1), (step + overhang, half * 0.95, top), paint),
        *wheels(OTHER_VEHICLE, [length * 0.34, -length * 0.25], half, 0.34, 0.22),
    ]
    for side in (-half - 0.01, half - 0.01):
        for x in (rear + 0.6, rear + 2.2):
            parts.append(box((x, side, 1.4), (x + 0.9, side + 0.02, 1.9), glass))
    return merge(parts)


def _farm_trailer(rng: Rng) -> Mesh:
    """Return a large trailer with boards, as tractors pull."""
    x, y, floor = rng.uniform([1.8, 0.95, 0.8], [3.2, 1.2, 1.1])
    top = floor + rng.uniform(0.4, 1.5)
    skin = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.2, 1.3)
    parts = [box((-x, -y, floor), (x, y, floor + 0.08), skin)]
    for side in (-y, y - 0.05):
        parts.append(box((-x, side, floor), (x, side + 0.05, top), skin))
    for end in (-x, x - 0.05):
        parts.append(box((end, -y, floor), (end + 0.05, y, top), skin))
    axles = [-0.6, 0.6] if rng.random() < 0.5 else [-x * 0.65, x * 0.65]
    parts += wheels(OTHER_VEHICLE, axles, y, 0.45, 0.3)
    return merge([*parts, *_drawbar(float(x))])


def _boat_trailer(rng: Rng) -> Mesh:
    """Return a trailer with a boat, a tank or a car on a low frame."""
    x = rng.uniform(1.8, 2.8)
    skin = Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.3, 1.5)
    parts = [box((-x, y - 0.05, 0.45), (x, y + 0.05, 0.55), IRON) for y in (-0.8, 0.0, 0.8)]
    keel = rng.uniform(0.5, 0.7)
    deck = rng.uniform(1.3, 1.8)
    path = [
        [-x, 0, deck - 0.5],
        [-x * 0.3, 0, deck - 0.5],
        [x * 0.6, 0, deck - 0.4],
        [x + 0.3, 0, deck],
    ]
    hull = np.array([0.8, 0.95, 0.7, 0.06]) * min(1.0, deck - keel)
    parts.append(tube(path, hull, skin, 9))
    parts += wheels(OTHER_VEHICLE, [-0.4], 1.0, 0.32, 0.2)
    return merge([*parts, *_drawbar(float(x))])
