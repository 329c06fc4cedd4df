# SPDX-License-Identifier: MIT
"""Cars, vans and trucks: lofted bodies with glass, pillars, wheels, lamps and plates.

Local frame: x forward, y left, the middle of the footprint at the origin, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, disc, merge, rings, tube
from salsanext_cli.synthesis.presets import CARS, LORRY_CAB, Body
from salsanext_cli.synthesis.surfaces import CAR, TRUCK, Material

SECTION_POINTS = 8
"""Points of a cross-section of a body."""


def _paint(rng: Rng) -> float:
    """Return the brightness of a car's paint: most are dark in the infrared."""
    kinds = ((0.0, 0.09), (0.1, 0.5), (0.5, 1.0), (1.0, 1.6))
    return float(rng.uniform(*kinds[rng.choice(4, p=(0.6, 0.14, 0.16, 0.1))]))


def _loft(body: Body, label: int, paint: float, stretch: Array) -> Mesh:
    """Return the body without wheels."""
    profile = body.profile
    x = (0.5 - profile[:, 0]) * body.length
    half = body.width / 2 * np.where(profile[:, 0] % 1.0 == 0, 0.86, 1.0)
    belt, roof, top = profile[:, 1], profile[:, 2], half * profile[:, 3]
    sill = np.full(len(x), body.bottom)
    middle = (sill + belt) / 2
    y = np.stack([-half * 0.94, -half, -half * 0.96, -top, top, half * 0.96, half, half * 0.94], -1)
    z = np.stack([sill, middle, belt, roof, roof, belt, middle, sill], -1)
    sections = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1)
    shell = rings(sections, Skin(label, Material.PAINT, paint))
    windows = np.zeros((len(x) - 1, SECTION_POINTS), bool)
    windows[np.ix_(body.cabin, (2, 4))] = windows[np.ix_(body.screens, (2, 3, 4))] = True
    glass = np.tile(windows.ravel(), 2)
    shell.materials[glass], shell.shades[glass] = Material.GLASS, 0.8
    fan = np.array([[0, k, k + 1] for k in range(1, SECTION_POINTS - 1)])
    ends = [Mesh.of(sections[i], fan, Skin(label, Material.PAINT, paint)) for i in (0, -1)]
    return merge([shell, *ends]).scaled(stretch)


def _wheels(label: int, axles: list[float], track: float, radius: float, wide: float) -> list[Mesh]:
    """Return wheels at both ends of axles: a tyre and, on its outside, a rim."""
    tyre, rim = Skin(label, Material.RUBBER), Skin(label, Material.METAL, 0.9)
    parts = []
    for x in axles:
        for side in (-1, 1):
            inner, outer = side * (track - wide), side * track
            parts.append(tube([[x, inner, radius], [x, outer, radius]], radius, tyre, 14))
            parts.append(disc((x, outer - side * 0.02, radius), radius * 0.97, tyre))
            parts.append(disc((x, outer + side * 0.01, radius), radius * 0.66, rim))
    return parts


def _fittings(body: Body, label: int, stretch: Array) -> list[Mesh]:
    """Return lamps, reflectors, number plates and mirrors."""
    lamp, retro = Skin(label, Material.LAMP), Skin(label, Material.RETRO)
    mirror = Skin(label, Material.PAINT, 0.4)
    front, rear = body.length / 2 * stretch[0], -body.length / 2 * stretch[0]
    half, height = body.width / 2 * stretch[1], body.profile[1, 1] * stretch[2]
    parts = [
        box((front - 0.02, -0.26, 0.38), (front + 0.015, 0.26, 0.49), retro),
        box((rear - 0.015, -0.26, 0.62), (rear + 0.02, 0.26, 0.73), retro),
    ]
    for side in (-1, 1):
        x, a, b, c = body.length * 0.16, side * (half - 0.36), side * (half - 0.1), side * half
        parts += [
            box((front - 0.3, a, height - 0.16), (front - 0.02, b, height), lamp),
            box((rear - 0.01, a, height + 0.05), (rear + 0.2, b, height + 0.2), lamp),
            box((rear - 0.02, a, 0.45), (rear + 0.02, b, 0.5), retro),
            box((x, c, height + 0.2), (x + 0.12, side * (half + 0.16), height + 0.36), mirror),
        ]
    return parts


def car(rng: Rng) -> Mesh:
    """Return a car of one of several shapes, sizes and paints."""
    body = CARS[rng.integers(len(CARS))]
    stretch = rng.uniform([0.93, 0.96, 0.96], [1.07, 1.03, 1.05])
    track = (body.width / 2 + 0.005) * stretch[1]
    axles = [0.31 * body.length * stretch[0], -0.30 * body.length * stretch[0]]
    parts = [
        _loft(body, CAR, _paint(rng), stretch),
        *_wheels(CAR, axles, track, body.wheel, 0.2),
        *_fittings(body, CAR, stretch),
    ]
    floor = Skin(CAR, Material.RUBBER)
    reach = body.length * 0.45
    parts.append(box((-reach, -0.7, body.bottom - 0.04), (reach, 0.7, body.bottom + 0.1), floor))
    if rng.random() < 0.15:
        top = body.profile[:, 2].max() * stretch[2]
        parts.append(box((-0.9, -0.5, top + 0.05), (0.8, 0.5, top + 0.3), floor))
    return merge(parts)


def truck(rng: Rng) -> Mesh:
    """Return a lorry: box, flatbed with a load, tipper, or semi-trailer."""
    paint, cargo_paint = float(rng.uniform(0.2, 1.5)), float(rng.uniform(0.7, 1.5))
    cab_scale = rng.uniform([0.85, 0.85, 0.85], [1.1, 1.08, 1.15])
    bed_length = float(rng.choice([rng.uniform(3.2, 5), rng.uniform(5, 7.5), rng.uniform(9, 13)]))
    cab_length = LORRY_CAB.length * cab_scale[0]
    half, floor = 1.12 * cab_scale[1], float(rng.uniform(0.75, 1.15))
    cargo = Skin(TRUCK, Material.PLASTER, cargo_paint)
    steel = Skin(TRUCK, Material.METAL, 0.5)
    front = bed_length / 2
    cab = _loft(LORRY_CAB, TRUCK, paint, cab_scale).moved((front + cab_length / 2 + 0.1, 0, 0))
    parts = [cab, box((-front, -0.4, 0.55), (front + cab_length, 0.4, floor), steel)]
    kind = rng.choice(3, p=(0.6, 0.22, 0.18))
    if kind == 0:
        top = floor + rng.uniform(1.6, 2.6)
        parts.append(box((-front, -half, floor), (front, half, top), cargo))
        for x in np.arange(-front, front, rng.uniform(0.6, 2.5)):
            parts.append(box((x, -half - 0.02, floor), (x + 0.05, half + 0.02, top), steel))
    else:
        top = floor + rng.uniform(0.3, 1.0)
        parts += [
            box((-front, -half, floor), (front, half, floor + 0.08), cargo),
            box((-front, -half, floor), (front, -half + 0.05, top), cargo),
            box((-front, half - 0.05, floor), (front, half, top), cargo),
            box((-front, -half, floor), (-front + 0.05, half, top), cargo),
            box((front - 0.05, -half, floor), (front, half, top + 0.5), cargo),
        ]
    for _ in range(int(rng.integers(2, 7)) if kind == 2 else 0):
        size = rng.uniform([0.5, 0.4, 0.3], [1.6, 1.0, 1.4])
        x, y = rng.uniform(-front, front - size[0]), rng.uniform(-half, half - size[1])
        skin = Skin.drawn(rng, TRUCK, Material.WOOD, 0.5, 1.1)
        parts.append(box((x, y, floor + 0.1), (x + size[0], y + size[1], floor + size[2]), skin))
    axles = [front + cab_length * 0.55, -front * 0.62]
    if bed_length > 6:
        axles += [-front * 0.62 + 1.15, -front * 0.62 - 1.15]
    parts += _wheels(TRUCK, axles, half, 0.46, 0.35)
    retro = Skin(TRUCK, Material.RETRO)
    for y in (-half + 0.1, half - 0.4):
        parts.append(box((-front - 0.03, y, 0.6), (-front + 0.01, y + 0.3, 0.75), retro))
    parts.append(box((-front - 0.02, -half, 0.42), (-front + 0.05, half, 0.52), steel))
    for side in (-1, 1):
        x, y = front + cab_length, side * (half + 0.02)
        parts.append(box((x - 0.25, y, 1.7), (x - 0.15, side * (half + 0.28), 2.3), steel))
    return merge(parts).moved((-(cab_length + 0.1) / 2, 0, 0))
