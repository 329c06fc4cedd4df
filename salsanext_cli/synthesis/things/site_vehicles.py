# SPDX-License-Identifier: MIT
"""Vehicles of building sites and yards: loaders, forklifts, rollers, dumpers, lifting platforms."""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, disc, merge, tube
from salsanext_cli.synthesis.presets import OTHER_VEHICLE, Material
from salsanext_cli.synthesis.things.bodywork import wheels

STEEL = Skin(OTHER_VEHICLE, Material.METAL, 0.6)
GLASS = Skin(OTHER_VEHICLE, Material.GLASS)


def site_vehicle(rng: Rng) -> Mesh:
    """Return a wheel loader, skid-steer loader, forklift, roller, dumper or lifting platform."""
    makers = (_wheel_loader, _wheel_loader, _skid_steer, _forklift, _roller, _dumper, _platform)
    return makers[rng.integers(len(makers))](rng)


def _paint(rng: Rng) -> Skin:
    return Skin.random(rng, OTHER_VEHICLE, Material.PAINT, 0.3, 1.5)


def _cabin(low: tuple[float, float, float], high: tuple[float, float, float], paint: Skin) -> Mesh:
    """Return a cabin of glass with posts and a roof, or open if it has no walls."""
    (x0, y0, z0) = low
    (x1, y1, z1) = high
    parts = [box(low, (x1, y1, z1 - 0.1), GLASS)]
    parts.append(box((x0 - 0.08, y0 - 0.08, z1 - 0.1), (x1 + 0.08, y1 + 0.08, z1), paint))
    for x in (x0 - 0.02, x1 - 0.06):
        for y in (y0 - 0.02, y1 - 0.06):
            parts.append(box((x, y, z0), (x + 0.08, y + 0.08, z1), paint))
    return merge(parts)


def _bucket(x: float, z: float, half: float) -> list[Mesh]:
    """Return an open bucket whose back is at x and floor at z."""
    return [
        box((x, -half, z), (x + 0.06, half, z + 0.75), STEEL),
        box((x, -half, z), (x + 0.8, half, z + 0.06), STEEL),
        box((x, -half, z), (x + 0.6, -half + 0.05, z + 0.5), STEEL),
        box((x, half - 0.05, z), (x + 0.6, half, z + 0.5), STEEL),
    ]


def _wheel_loader(rng: Rng) -> Mesh:
    paint = _paint(rng)
    lift = rng.uniform(0.1, 2.0)
    reach = rng.uniform(2.9, 3.4)
    parts = [
        box((-2.6, -0.85, 0.9), (-0.5, 0.85, 1.9), paint),
        box((0.4, -0.5, 0.7), (1.9, 0.5, 1.4), paint),
        _cabin((-0.6, -0.7, 1.3), (0.6, 0.7, 3.0), paint),
        *wheels(OTHER_VEHICLE, [-1.5, 1.5], 1.2, 0.75, 0.5),
        *_bucket(reach, lift, 1.25),
    ]
    for y in (-0.5, 0.5):
        arm = [[1.0, y, 1.7], [2.2, y, 1.2 + lift / 2], [reach, y, lift + 0.3]]
        parts.append(tube(arm, 0.13, paint))
    return merge(parts).scaled(rng.uniform(0.7, 1.05))


def _skid_steer(rng: Rng) -> Mesh:
    paint = _paint(rng)
    lift = rng.uniform(0.05, 1.5)
    parts = [
        box((-1.3, -0.7, 0.3), (0.6, 0.7, 1.0), paint),
        _cabin((-0.6, -0.5, 1.0), (0.5, 0.5, 2.05), paint),
        *wheels(OTHER_VEHICLE, [-0.7, 0.5], 0.85, 0.42, 0.28),
        *_bucket(1.3, lift, 0.9),
    ]
    for y in (-0.7, 0.7):
        arm = [[-1.2, y, 1.5], [0.6, y, 1.3 + lift / 3], [1.3, y, lift + 0.3]]
        parts.append(tube(arm, 0.1, paint))
    return merge(parts).scaled(rng.uniform(0.9, 1.15))


def _forklift(rng: Rng) -> Mesh:
    paint = _paint(rng)
    lift = rng.uniform(0.1, 1.4)
    mast = rng.uniform(2.0, 3.2)
    parts = [
        box((-1.2, -0.55, 0.25), (0.5, 0.55, 0.95), paint),
        box((-1.3, -0.55, 0.5), (-0.8, 0.55, 1.3), paint),
        *wheels(OTHER_VEHICLE, [-0.8, 0.5], 0.6, 0.3, 0.2),
        box((-0.9, -0.5, 2.0), (0.4, 0.5, 2.08), paint),
    ]
    for y in (-0.5, 0.42):
        for x in (-0.9, 0.32):
            parts.append(box((x, y, 0.9), (x + 0.08, y + 0.08, 2.05), paint))
    for y in (-0.4, 0.32):
        parts.append(box((0.75, y, 0.1), (0.87, y + 0.08, mast), STEEL))
        parts.append(box((0.87, y, lift), (1.95, y + 0.1, lift + 0.05), STEEL))
    if rng.random() < 0.5:
        load = Skin.random(rng, OTHER_VEHICLE, Material.WOOD, 0.4, 1.2)
        parts.append(box((0.95, -0.5, lift + 0.05), (1.9, 0.5, lift + rng.uniform(0.4, 1.2)), load))
    return merge(parts).scaled(rng.uniform(0.9, 1.3))


def _roller(rng: Rng) -> Mesh:
    paint = _paint(rng)
    radius = rng.uniform(0.5, 0.7)
    parts = [
        box((-1.6, -0.7, radius), (0.2, 0.7, radius + 0.7), paint),
        box((0.2, -0.35, radius), (1.1, 0.35, radius + 0.4), paint),
        box((-0.5, -0.65, radius + 1.6), (0.6, 0.65, radius + 1.7), paint),
        tube([[1.3, -0.75, radius], [1.3, 0.75, radius]], radius, STEEL, 14),
        *wheels(OTHER_VEHICLE, [-1.1], 0.9, radius, 0.4),
    ]
    for y in (-0.75, 0.75):
        parts.append(disc((1.3, y, radius), radius, STEEL))
        parts.append(tube([[-0.4, y * 0.8, radius], [-0.4, y * 0.8, radius + 1.65]], 0.04, paint))
        parts.append(tube([[0.5, y * 0.8, radius], [0.5, y * 0.8, radius + 1.65]], 0.04, paint))
    return merge(parts).scaled(rng.uniform(0.8, 1.2))


def _dumper(rng: Rng) -> Mesh:
    paint = _paint(rng)
    parts = [
        box((-1.4, -0.6, 0.6), (0.0, 0.6, 1.2), paint),
        tube([[0.2, 0, 1.0], [0.5, 0, 1.1], [1.7, 0, 1.35]], [0.5, 0.7, 0.95], paint, 8),
        *wheels(OTHER_VEHICLE, [-0.9, 1.0], 0.95, 0.5, 0.35),
    ]
    for y in (-0.55, 0.5):
        parts.append(box((-0.9, y, 1.2), (-0.84, y + 0.05, 2.5), STEEL))
    parts.append(box((-0.9, -0.55, 2.44), (-0.84, 0.55, 2.5), STEEL))
    return merge(parts).scaled(rng.uniform(0.8, 1.2))


def _platform(rng: Rng) -> Mesh:
    """Return a lifting platform: a low base, a folded or raised boom and a basket."""
    paint = _paint(rng)
    height = rng.uniform(1.2, 4.0)
    foot = np.array([0.3, 0, 0.9])
    elbow = np.array([-1.2, 0, 0.9 + height / 2])
    tip = np.array([rng.uniform(1.0, 2.0), 0, height])
    parts = [
        box((-1.2, -0.7, 0.4), (1.2, 0.7, 0.9), paint),
        *wheels(OTHER_VEHICLE, [-0.9, 0.9], 0.85, 0.4, 0.25),
        tube(np.stack([foot, elbow]), 0.14, paint),
        tube([elbow, tip], 0.12, paint),
        box(tip + [0, -0.6, -0.3], tip + [0.8, 0.6, -0.25], STEEL),
    ]
    for y in (-0.6, 0.56):
        parts.append(box(tip + [0, y, 0.7], tip + [0.8, y + 0.04, 0.74], STEEL))
        for x in (0.0, 0.76):
            parts.append(box(tip + [x, y, -0.3], tip + [x + 0.04, y + 0.04, 0.74], STEEL))
    return merge(parts)
