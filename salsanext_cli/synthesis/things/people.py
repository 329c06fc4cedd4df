# SPDX-License-Identifier: MIT
"""People on foot: standing, walking, sitting, with luggage."""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, ellipsoid, merge, tube
from salsanext_cli.synthesis.surfaces import PERSON, Material

HIP, SHOULDER, SEAT = 0.52, 0.82, 0.28
"""Heights of standing hips and shoulders and of a seat, as shares of the person's height."""


def limb(start: Array, joint: Array, end: Array, radii: tuple[float, float], skin: Skin) -> Mesh:
    """Return an arm or a leg with a joint."""
    first, last = radii
    return tube([start, joint, end], [first, (first + last) / 2, last], skin)


def person(rng: Rng, *, sitting: bool = False) -> Mesh:
    """Return a person 1.1 to 1.95 m tall, perhaps with a bag, a coat or a box; seated at 0.5 m."""
    height = float(rng.uniform(1.1, 1.5) if rng.random() < 0.12 else rng.uniform(1.55, 1.95))
    top = Skin.random(rng, PERSON, Material.CLOTH, 0.3, 1.4)
    bottom = Skin.random(rng, PERSON, Material.CLOTH, 0.3, 1.35)
    stride = rng.uniform(0.03, 0.2) * (1 if rng.random() < 0.75 else 0.1)
    girth = rng.uniform(0.85, 1.3)
    upper = merge([*_torso(rng, stride, girth, top), *_luggage(rng)])
    parts = [upper.moved((0, 0, (SEAT - HIP) * sitting))]
    parts += _sitting_legs(bottom) if sitting else _legs(stride, bottom)
    if not sitting and rng.random() < 0.3:
        coat = [[0, 0, 0.3], [0, 0, HIP + 0.04]]
        parts.append(tube(coat, [0.13 * girth, 0.09 * girth], bottom, 9))
    return merge(parts).scaled(height)


def _torso(rng: Rng, stride: float, girth: float, cloth: Skin) -> list[Mesh]:
    """Return head, trunk and arms of a person 1 m tall."""
    bare = Skin(PERSON, Material.SKIN)
    spine = [[0, 0, HIP - 0.03], [0.005, 0, 0.62], [0, 0, 0.76], [0, 0, SHOULDER + 0.02]]
    trunk = tube(spine, np.array([0.085, 0.08, 0.098, 0.06]) * girth, cloth, 9)
    parts = [
        ellipsoid((0.01, 0, 0.935), (0.062, 0.05, 0.075), bare),
        tube([[0, 0, 0.84], [0, 0, 0.9]], 0.033, bare, 6),
        trunk.scaled((0.8, 1.2, 1)),
    ]
    lifted = rng.uniform(0, 0.3) * (rng.random() < 0.3)
    for side, swing in ((1, stride), (-1, -stride)):
        raised = rng.uniform(0.0, 0.12) + lifted
        elbow = np.array([-swing * 0.35 + lifted / 3, side * 0.14 * girth, 0.64])
        hand = np.array([-swing * 0.8 + raised, side * 0.145 * girth, 0.5 + raised])
        arm = np.array([0, side * 0.11 * girth, SHOULDER - 0.01])
        parts.append(limb(arm, elbow, hand, (0.034, 0.022), cloth))
    return parts


def _legs(stride: float, cloth: Skin) -> list[Mesh]:
    parts = []
    for side, swing in ((1, stride), (-1, -stride)):
        foot = np.array([swing, side * 0.05, 0.03])
        knee = np.array([swing * 0.5 + 0.03, side * 0.052, 0.28])
        parts.append(limb(np.array([0, side * 0.05, HIP]), knee, foot, (0.055, 0.032), cloth))
        sole = foot + np.array([0.035, 0, -0.008])
        parts.append(ellipsoid(sole, (0.08, 0.03, 0.025), Skin(PERSON, Material.RUBBER)))
    return parts


def _sitting_legs(cloth: Skin) -> list[Mesh]:
    hip, knee, foot = np.array([[0, 0, SEAT], [0.26, 0, SEAT], [0.28, 0, 0.02]])
    asides = (np.array([0, y, 0]) for y in (-0.06, 0.06))
    return [limb(hip + a, knee + a, foot + a, (0.055, 0.035), cloth) for a in asides]


def _luggage(rng: Rng) -> list[Mesh]:
    """Return up to two of a rucksack, a bag on either side and a box in the arms."""
    bag = Skin.random(rng, PERSON, Material.CLOTH, 0.3, 1.2)
    corners = (
        ((-0.17, -0.09, 0.58), (-0.07, 0.09, 0.8)),
        ((-0.1, 0.13, 0.3), (0.1, 0.19, 0.48)),
        ((0.08, -0.13, 0.55), (0.24, 0.13, 0.7)),
        ((-0.08, -0.19, 0.32), (0.08, -0.13, 0.5)),
    )
    kinds = set(rng.choice(5, 2, p=(0.15, 0.1, 0.05, 0.1, 0.6)).tolist()) - {len(corners)}
    return [box(*corners[kind], bag) for kind in kinds]
