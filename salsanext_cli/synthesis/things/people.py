# SPDX-License-Identifier: MIT
"""People on foot and on bicycles, and bicycles alone.

Local frame: x forward, y left, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, ellipsoid, merge, tube
from salsanext_cli.synthesis.surfaces import BICYCLE, BICYCLIST, PERSON, Material

WHEEL_M = 0.34
"""Radius of a bicycle's wheel."""
AXLE_M = 0.52
"""Half the distance between the axles of a bicycle."""


def _limb(start: Array, joint: Array, end: Array, radii: tuple[float, float], skin: Skin) -> Mesh:
    return tube([start, joint, end], [radii[0], (radii[0] + radii[1]) / 2, radii[1]], skin, 7)


def person(rng: Rng) -> Mesh:
    """Return a person who stands or walks, 1.1 to 1.95 m tall, perhaps with a bag or a coat."""
    height = float(rng.uniform(1.1, 1.5) if rng.random() < 0.12 else rng.uniform(1.55, 1.95))
    top = Skin.drawn(rng, PERSON, Material.CLOTH, 0.55, 1.2)
    bottom = Skin.drawn(rng, PERSON, Material.CLOTH, 0.5, 1.15)
    bare = Skin(PERSON, Material.SKIN)
    stride = float(rng.uniform(0.03, 0.2)) * (1 if rng.random() < 0.75 else 0.1)
    hip, shoulder, girth = 0.52, 0.82, float(rng.uniform(0.85, 1.3))
    parts = [
        ellipsoid((0.01, 0, 0.935), (0.062, 0.05, 0.075), bare),
        tube([[0, 0, 0.84], [0, 0, 0.9]], 0.033, bare, 6),
        tube(
            [[0, 0, hip - 0.03], [0.005, 0, 0.62], [0, 0, 0.76], [0, 0, shoulder + 0.02]],
            np.array([0.085, 0.08, 0.098, 0.06]) * girth, top, 9,
        ).scaled((0.8, 1.2, 1)),
    ]  # fmt: skip
    for side, swing in ((1, stride), (-1, -stride)):
        foot = np.array([swing, side * 0.05, 0.03])
        knee = np.array([swing * 0.5 + 0.03, side * 0.052, 0.28])
        parts.append(_limb(np.array([0, side * 0.05, hip]), knee, foot, (0.055, 0.032), bottom))
        sole = foot + np.array([0.035, 0, -0.008])
        parts.append(ellipsoid(sole, (0.08, 0.03, 0.025), Skin(PERSON, Material.RUBBER)))
        raised = rng.uniform(0.0, 0.12)
        elbow = np.array([-swing * 0.35, side * 0.14 * girth, 0.64])
        hand = np.array([-swing * 0.8 + raised, side * 0.145 * girth, 0.5 + raised])
        arm = np.array([0, side * 0.11 * girth, shoulder - 0.01])
        parts.append(_limb(arm, elbow, hand, (0.034, 0.022), top))
    if rng.random() < 0.3:
        radii = [0.13 * girth, 0.09 * girth]
        parts.append(tube([[0, 0, 0.3], [0, 0, hip + 0.04]], radii, bottom, 9))
    if rng.random() < 0.3:
        bag = Skin.drawn(rng, PERSON, Material.CLOTH, 0.4, 1.1)
        parts.append(box((-0.17, -0.09, 0.58), (-0.07, 0.09, 0.8), bag))
    elif rng.random() < 0.25:
        bag = Skin.drawn(rng, PERSON, Material.CLOTH, 0.4, 1.1)
        parts.append(box((-0.1, 0.13, 0.3), (0.1, 0.19, 0.48), bag))
    return merge(parts).scaled(height)


def _ring(centre: Array, radius: float, thickness: float, skin: Skin) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, 15)
    path = centre + np.stack([radius * np.cos(angle), np.zeros(15), radius * np.sin(angle)], -1)
    return tube(path, thickness, skin, 5)


def bicycle(rng: Rng, label: int = BICYCLE) -> Mesh:
    """Return a bicycle: wheels with spokes and mudguards, frame, handlebar, saddle, baskets."""
    frame = Skin.drawn(rng, label, Material.METAL, 0.6, 1.6)
    tyre = Skin(label, Material.RUBBER, 3.0)
    saddle, crank = np.array([-0.22, 0, 0.92]), np.array([-0.05, 0, 0.3])
    head, fork = np.array([0.33, 0, 0.85]), np.array([AXLE_M, 0, WHEEL_M])
    rear = np.array([-AXLE_M, 0, WHEEL_M])
    bars = [
        (saddle - [0, 0, 0.1], crank), (saddle * [0.9, 1, 0.85], head - [0, 0, 0.08]),
        (crank, head - [-0.02, 0, 0.14]), (crank, rear), (saddle * [1, 1, 0.8], rear),
        (head + np.array([-0.03, 0, 0.16]), fork), (saddle - [0, 0, 0.25], saddle),
        (head + np.array([-0.05, -0.28, 0.17]), head + np.array([-0.05, 0.28, 0.17])),
    ]  # fmt: skip
    parts = [tube([a, b], 0.026, frame, 6) for a, b in bars]
    for hub in (fork, rear):
        parts.append(_ring(hub, WHEEL_M - 0.02, 0.028, tyre))
        turn = rng.uniform(0, np.pi)
        for angle in turn + np.arange(5) * np.pi / 5:
            reach = (WHEEL_M - 0.03) * np.array([np.cos(angle), 0, np.sin(angle)])
            parts.append(tube([hub - reach, hub + reach], 0.009, frame, 4))
    parts.append(ellipsoid(saddle, (0.13, 0.07, 0.04), tyre))
    parts.append(ellipsoid(crank, (0.1, 0.06, 0.1), frame))
    pedals = box((-0.02, -0.1, -0.02), (0.02, 0.1, 0.02), tyre)
    parts.append(pedals.moved(crank + np.array([0, 0, -0.14])))
    reflector = Skin(label, Material.RETRO)
    parts.append(box((-0.62, -0.03, 0.6), (-0.59, 0.03, 0.66), reflector))
    if rng.random() < 0.6:
        parts.append(box((-0.7, -0.07, 0.71), (-0.28, 0.07, 0.73), frame))
    if rng.random() < 0.35:
        basket = Skin(label, Material.WOOD, 0.9)
        parts.append(box((0.36, -0.17, 0.8), (0.64, 0.17, 1.02), basket))
    if rng.random() < 0.2:
        parts.append(box((-0.72, 0.08, 0.42), (-0.36, 0.2, 0.7), Skin(label, Material.CLOTH, 0.8)))
    return merge(parts).scaled(rng.uniform([0.92, 0.95, 0.95], [1.06, 1.05, 1.06]))


def rider(rng: Rng) -> Mesh:
    """Return a bicycle with its rider, all of it labelled as rider."""
    cloth = Skin.drawn(rng, BICYCLIST, Material.CLOTH, 0.6, 1.2)
    trousers = Skin.drawn(rng, BICYCLIST, Material.CLOTH, 0.5, 1.1)
    bare = Skin(BICYCLIST, Material.SKIN)
    lean = rng.uniform(0.08, 0.4)
    hip = np.array([-0.2, 0, 0.98])
    shoulder = hip + np.array([lean, 0, 0.5 - 0.3 * lean])
    girth = float(rng.uniform(0.9, 1.25))
    pelvis, neck = hip - np.array([0.02, 0, 0.08]), shoulder + np.array([0.03, 0, 0.07])
    spine = [pelvis, (hip + shoulder) / 2, shoulder, neck]
    parts = [
        bicycle(rng, BICYCLIST),
        tube(spine, np.array([0.15, 0.16, 0.17, 0.08]) * girth, cloth, 9),
        tube([shoulder, shoulder + np.array([0.07, 0, 0.2])], 0.06, bare, 6),
        ellipsoid(shoulder + np.array([0.08, 0, 0.24]), (0.11, 0.09, 0.14), bare),
    ]
    turn = rng.uniform(0, 2 * np.pi)
    for side in (-1, 1):
        angle = turn + (side > 0) * np.pi
        foot = np.array([-0.05 + 0.16 * np.cos(angle), side * 0.13, 0.3 + 0.16 * np.sin(angle)])
        knee = (hip + foot) / 2 + [0.2, side * 0.02, 0.08]
        thigh = hip + np.array([0, side * 0.09, 0])
        parts.append(_limb(thigh, knee, foot, (0.09, 0.055), trousers))
        hand = np.array([0.3, side * 0.25, 1.02])
        elbow = (shoulder + hand) / 2 + [-0.03, side * 0.08, -0.08]
        arm = shoulder + np.array([0, side * 0.17, -0.02])
        parts.append(_limb(arm, elbow, hand, (0.055, 0.04), cloth))
    if rng.random() < 0.3:
        parts.append(box((-0.36, -0.16, 1.1), (-0.16, 0.16, 1.5), cloth))
    return merge(parts)
