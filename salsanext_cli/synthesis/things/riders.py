# SPDX-License-Identifier: MIT
"""People on bicycles and motorcycles, labelled as a whole as rider.

Local frame: x forward, y left, the ground at z = 0.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, ellipsoid, merge, tube
from salsanext_cli.synthesis.surfaces import BICYCLIST, MOTORCYCLIST, Material
from salsanext_cli.synthesis.things.bodies import dark_paint
from salsanext_cli.synthesis.things.cycles import bicycle, motorcycle
from salsanext_cli.synthesis.things.people import limb


def _seated(rng: Rng, label: int, hip: Array, lean: float, feet: Array, grip: Array) -> list[Mesh]:
    """Return a person on a saddle; `feet` (2, 3) right and left, `grip` the left hand."""
    cloth = Skin.drawn(rng, label, Material.CLOTH, 0.4, 1.3)
    trousers = Skin.drawn(rng, label, Material.CLOTH, 0.3, 1.2)
    shoulder = hip + np.array([lean, 0, 0.5 - 0.3 * lean])
    girth = float(rng.uniform(0.9, 1.25))
    pelvis, neck = hip - np.array([0.02, 0, 0.08]), shoulder + np.array([0.03, 0, 0.07])
    spine = [pelvis, (hip + shoulder) / 2, shoulder, neck]
    parts = [
        tube(spine, np.array([0.15, 0.16, 0.17, 0.08]) * girth, cloth, 9),
        tube([shoulder, shoulder + np.array([0.07, 0, 0.2])], 0.06, Skin(label, Material.SKIN), 6),
    ]
    for side, foot in zip((-1, 1), feet, strict=True):
        knee = (hip + foot) / 2 + [0.2, side * 0.02, 0.08]
        thigh = hip + np.array([0, side * 0.09, 0])
        parts.append(limb(thigh, knee, foot, (0.09, 0.055), trousers))
        hand = grip * [1, side, 1]
        elbow = (shoulder + hand) / 2 + [-0.03, side * 0.08, -0.08]
        arm = shoulder + np.array([0, side * 0.17, -0.02])
        parts.append(limb(arm, elbow, hand, (0.055, 0.04), cloth))
    if rng.random() < 0.3:
        x, z = hip[0], hip[2]
        parts.append(box((x - 0.18, -0.16, z + 0.12), (x + 0.04, 0.16, z + 0.52), cloth))
    return parts


def _head(hip: Array, lean: float, size: float, skin: Skin) -> Mesh:
    centre = hip + np.array([lean + 0.08, 0, 0.74 - 0.3 * lean])
    return ellipsoid(centre, np.array([0.11, 0.09, 0.14]) * size, skin)


def bicyclist(rng: Rng) -> Mesh:
    """Return a bicycle with its rider."""
    hip, lean, turn = np.array([-0.2, 0, 0.98]), rng.uniform(0.08, 0.4), rng.uniform(0, 2 * np.pi)
    angle = turn + np.array([0, np.pi])
    feet = np.stack(
        [-0.05 + 0.16 * np.cos(angle), np.array([-0.13, 0.13]), 0.3 + 0.16 * np.sin(angle)], -1
    )
    body = _seated(rng, BICYCLIST, hip, lean, feet, np.array([0.3, 0.25, 1.02]))
    head = _head(hip, lean, 1.0, Skin(BICYCLIST, Material.SKIN))
    return merge([bicycle(rng, BICYCLIST), *body, head])


def motorcyclist(rng: Rng) -> Mesh:
    """Return a motorcycle with one or two riders in helmets."""
    parts = [motorcycle(rng, MOTORCYCLIST)]
    helmet = Skin(MOTORCYCLIST, Material.PAINT, dark_paint(rng))
    for n in range(2 if rng.random() < 0.15 else 1):
        hip, lean = np.array([-0.25 - 0.35 * n, 0, 0.87 + 0.06 * n]), rng.uniform(0.05, 0.35)
        feet = np.array([[0.0, -0.2, 0.36], [0.0, 0.2, 0.36]]) - [0.3 * n, 0, 0]
        grip = np.array([0.3 - 0.5 * n, 0.3, 1.02])
        parts += _seated(rng, MOTORCYCLIST, hip, lean, feet, grip)
        parts.append(_head(hip, lean, 1.35, helmet))
    return merge(parts)
