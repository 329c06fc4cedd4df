# SPDX-License-Identifier: MIT
"""Riders with their bicycle or motorcycle, riding, halting, or walking beside it.

As in SemanticKITTI, rider and vehicle have the label of the rider, and so have a person within
arm's reach of a bicycle and the bicycle.
"""

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge, tube
from salsanext_cli.synthesis.presets import BICYCLIST, MOTORCYCLIST, Material
from salsanext_cli.synthesis.things import figures, people


def riding_bicyclist(rng: Rng) -> Mesh:
    """Return a cyclist in motion, perhaps with a box or a child's seat, or with a trailer."""
    parts = [people.bicyclist(rng)]
    draw = rng.random()
    if draw < 0.1:
        parts.append(_child_trailer(rng))
    elif draw < 0.2:
        parts.append(_cargo_box(rng))
    elif draw < 0.3:
        parts.append(_child_on_carrier(rng))
    return merge(parts)


def halting_bicyclist(rng: Rng) -> Mesh:
    """Return a cyclist who stands astride a bicycle, one or both feet on the ground."""
    hip = np.array([rng.uniform(-0.2, 0.05), 0, rng.uniform(0.82, 0.94)])
    right, left = rng.uniform(-0.1, 0.15, 2)
    feet = np.array([[right, -0.25, 0.05], [left, 0.25, 0.05]])
    if rng.random() < 0.5:
        feet[int(rng.integers(2))] = [0.05, 0.13 * rng.choice([-1, 1]), 0.3]
        feet[:, 1] = np.abs(feet[:, 1]) * [-1, 1]
    lean = rng.uniform(-0.05, 0.3)
    body = people.seated(rng, BICYCLIST, hip, lean, feet, np.array([0.3, 0.25, 1.02]))
    head = people.head(hip, lean, 1.0, Skin(BICYCLIST, Material.SKIN))
    tilt = rng.normal(0, 0.08)
    return merge([people.bicycle(rng, BICYCLIST).leaned(tilt), *body, head])


def pushing_bicyclist(rng: Rng) -> Mesh:
    """Return a person who walks or stands beside a bicycle within arm's reach."""
    name = "walking" if rng.random() < 0.7 else "standing"
    side = rng.choice([-1, 1])
    gestures = ("pushing", "carrying") if side < 0 else ("carrying", "pushing")
    body = figures.figure(rng, figures.draw_stance(rng, name), gestures, BICYCLIST)
    bicycle = people.bicycle(rng, BICYCLIST).leaned(side * rng.uniform(-0.05, 0.12))
    return merge([bicycle, body.moved((rng.uniform(-0.35, 0.1), side * rng.uniform(0.4, 0.55), 0))])


def halting_motorcyclist(rng: Rng) -> Mesh:
    """Return a motorcyclist whose feet are on the ground."""
    hip = np.array([-0.25, 0, 0.85])
    lean = rng.uniform(-0.05, 0.25)
    feet = np.array([[0.05, -0.36, 0.05], [0.05, 0.36, 0.05]]) + rng.normal(0, 0.04, (2, 3))
    feet[:, 2] = 0.05
    helmet = Skin.random(rng, MOTORCYCLIST, Material.PAINT, 0.1, 1.2)
    grip = np.array([0.3, 0.3, 1.02]) if rng.random() < 0.7 else np.array([0.0, 0.2, 0.85])
    body = people.seated(rng, MOTORCYCLIST, hip, lean, feet, grip)
    machine = people.motorcycle(rng, MOTORCYCLIST)
    return merge([machine, *body, people.head(hip, lean, 1.35, helmet)])


def riding_motorcyclist(rng: Rng) -> Mesh:
    """Return a motorcyclist in motion, perhaps with a passenger or a delivery box."""
    parts = [people.motorcyclist(rng)]
    if rng.random() < 0.2:
        skin = Skin.random(rng, MOTORCYCLIST, Material.PAINT, 0.3, 1.4)
        parts.append(box((-1.05, -0.25, 0.8), (-0.6, 0.25, 1.3), skin))
    return merge(parts)


def halting_rider(rng: Rng) -> Mesh:
    """Return a cyclist or a motorcyclist who stands."""
    makers = (halting_bicyclist, pushing_bicyclist, halting_motorcyclist)
    return makers[rng.integers(len(makers))](rng)


def _child_trailer(rng: Rng) -> Mesh:
    cloth = Skin.random(rng, BICYCLIST, Material.CLOTH, 0.4, 1.3)
    tyre = Skin(BICYCLIST, Material.RUBBER, 2.0)
    x = -1.5
    parts = [box((x - 0.4, -0.32, 0.2), (x + 0.35, 0.32, rng.uniform(0.75, 0.95)), cloth)]
    for y in (-0.36, 0.36):
        parts.append(tube([[x, y - 0.02, 0.25], [x, y + 0.02, 0.25]], 0.25, tyre, 9))
    parts.append(tube([[x + 0.3, -0.25, 0.3], [-0.5, -0.08, 0.34]], 0.02, tyre, 4))
    return merge(parts)


def _cargo_box(rng: Rng) -> Mesh:
    """Return the box of a cargo bicycle between handlebar and front wheel."""
    wood = Skin.random(rng, BICYCLIST, Material.WOOD, 0.4, 1.1)
    return box((0.5, -0.3, 0.35), (1.35, 0.3, rng.uniform(0.7, 0.95)), wood)


def _child_on_carrier(rng: Rng) -> Mesh:
    stance = figures.draw_stance(rng, "sitting")
    child = figures.figure(rng, stance, ("carrying", "carrying"), BICYCLIST)
    return child.scaled(0.55).moved((-0.55, 0, 0.6))
