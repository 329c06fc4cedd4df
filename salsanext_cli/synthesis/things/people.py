# SPDX-License-Identifier: MIT
"""People on foot, bicycles and motorcycles; with a rider, all of it has the label of the rider."""

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, disc, ellipsoid, merge, tube
from salsanext_cli.synthesis.presets import Material
from salsanext_cli.synthesis.things import figures
from salsanext_cli.synthesis.things.bodywork import dark_paint

TYRE_SHADE = 3.0  # Brighter than car tyres; streets clip shades at 2.2
WHEEL_M = 0.34  # Radius of a bicycle's wheel
COVERED_SHARE = 0.2  # Of the parked motorcycles
AXLE_M = 0.52  # Half the distance between the axles of a bicycle


def person(rng: Rng, *, sitting: bool = False) -> Mesh:
    """Return a person who stands, walks or sits on a seat, the arms mostly at the sides."""
    moving = "walking" if rng.random() < 0.75 else "standing"
    stance = figures.draw_stance(rng, "sitting" if sitting else moving)
    gesture = "carrying" if rng.random() < 0.3 else "hanging"
    return figures.figure(rng, stance, (gesture, "hanging"))


def _ring(centre: Array, radius: float, thickness: float, skin: Skin) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, 15)
    path = centre + np.stack([radius * np.cos(angle), np.zeros(15), radius * np.sin(angle)], -1)
    return tube(path, thickness, skin, 5)


def bicycle(rng: Rng, label: int = presets.BICYCLE) -> Mesh:
    """Return a bicycle: spoked wheels, frame, handlebar, saddle, perhaps a carrier and baskets."""
    frame = Skin.random(rng, label, Material.METAL, 0.6, 2.2)
    tyre = Skin(label, Material.RUBBER, TYRE_SHADE)
    saddle = np.array([-0.22, 0, 0.92])
    crank = np.array([-0.05, 0, 0.3])
    head = np.array([0.33, 0, 0.85])
    fork = np.array([AXLE_M, 0, WHEEL_M])
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
    parts.append(pedals.moved(crank - [0, 0, 0.14]))
    parts.append(box((-0.62, -0.03, 0.6), (-0.59, 0.03, 0.66), Skin(label, Material.RETRO)))
    if rng.random() < 0.6:
        parts.append(box((-0.7, -0.07, 0.71), (-0.28, 0.07, 0.73), frame))
    if rng.random() < 0.35:
        parts.append(box((0.36, -0.17, 0.8), (0.64, 0.17, 1.02), Skin(label, Material.WOOD, 0.9)))
    if rng.random() < 0.2:
        parts.append(box((-0.72, 0.08, 0.42), (-0.36, 0.2, 0.7), Skin(label, Material.CLOTH, 0.8)))
    return merge(parts).scaled(rng.uniform([0.92, 0.95, 0.95], [1.06, 1.05, 1.06]))


def motorcycle(rng: Rng, label: int = presets.MOTORCYCLE) -> Mesh:
    """Return a motorcycle or a scooter; some parked ones are under a cover."""
    paint = dark_paint(rng, label)
    iron = Skin(label, Material.METAL, 0.6)
    tyre = Skin.random(rng, label, Material.RUBBER, 0.5, TYRE_SHADE)
    scooter = rng.random() < 0.4
    radius = 0.23 if scooter else 0.31
    front = np.array([0.68, 0, radius])
    rear = np.array([-0.62, 0, radius])
    head = np.array([0.4, 0, 0.95])
    bar = np.array([0.33, 0, 1.04])
    parts = [tube([head, front], 0.05, iron), tube([head, bar], 0.03, iron)]
    for hub in (front, rear):
        parts.append(_ring(hub, radius - 0.05, 0.065, tyre))
        parts.append(disc(hub, radius * 0.6, iron))
    parts.append(tube([bar - [0.05, 0.36, 0], bar, bar - [0.05, -0.36, 0]], 0.025, iron, 5))
    parts.append(ellipsoid(head + [0.1, 0, -0.06], (0.09, 0.1, 0.1), Skin(label, Material.LAMP)))
    parts.append(box((-0.86, -0.1, 0.5), (-0.83, 0.1, 0.64), Skin(label, Material.RETRO)))
    parts += (_scooter if scooter else _engine)(paint, iron, tyre)
    if rng.random() < 0.4:
        parts.append(box((0.42, -0.2, 0.95), (0.45, 0.2, 1.35), Skin(label, Material.GLASS)))
    if rng.random() < 0.4:
        parts.append(box((-0.9, -0.2, 0.85), (-0.55, 0.2, 1.15), paint))
    if label == presets.MOTORCYCLE and rng.random() < COVERED_SHARE:
        cover = Skin.random(rng, label, Material.CLOTH, 0.2, 1.2)
        parts += [
            ellipsoid((-0.3, 0, 0.55), (0.72, 0.3, 0.45), cover),
            ellipsoid((0.38, 0, 0.7), (0.42, 0.38, 0.45), cover),
        ]
    return merge(parts).scaled(rng.uniform([0.9, 0.9, 0.92], [1.12, 1.1, 1.08]))


def _engine(paint: Skin, iron: Skin, seat: Skin) -> list[Mesh]:
    return [
        ellipsoid((0.15, 0, 0.82), (0.3, 0.15, 0.14), paint),
        ellipsoid((-0.35, 0, 0.8), (0.42, 0.14, 0.08), seat),
        box((-0.2, -0.17, 0.28), (0.3, 0.17, 0.66), iron),
        tube([[0.2, -0.2, 0.35], [-0.7, -0.22, 0.4]], 0.06, iron),
        box((-0.75, -0.06, 0.62), (-0.3, 0.06, 0.74), paint),
    ]


def _scooter(paint: Skin, iron: Skin, seat: Skin) -> list[Mesh]:
    return [
        box((0.36, -0.2, 0.35), (0.42, 0.2, 0.95), paint),
        box((-0.15, -0.17, 0.26), (0.4, 0.17, 0.34), iron),
        ellipsoid((-0.42, 0, 0.55), (0.42, 0.2, 0.25), paint),
        ellipsoid((-0.38, 0, 0.8), (0.36, 0.15, 0.07), seat),
    ]


def seated(rng: Rng, label: int, hip: Array, lean: float, feet: Array, grip: Array) -> list[Mesh]:
    """Return a person on a saddle; `feet` (2, 3) right and left, `grip` the left hand."""
    cloth = Skin.random(rng, label, Material.CLOTH, 0.4, 1.3)
    trousers = Skin.random(rng, label, Material.CLOTH, 0.3, 1.2)
    shoulder = hip + np.array([lean, 0, 0.5 - 0.3 * lean])
    girth = float(rng.uniform(0.9, 1.25))
    pelvis = hip - np.array([0.02, 0, 0.08])
    neck = shoulder + np.array([0.03, 0, 0.07])
    spine = [pelvis, (hip + shoulder) / 2, shoulder, neck]
    parts = [
        tube(spine, np.array([0.15, 0.16, 0.17, 0.08]) * girth, cloth, 9),
        tube([shoulder, shoulder + np.array([0.07, 0, 0.2])], 0.06, Skin(label, Material.SKIN), 6),
    ]
    for side, foot in zip((-1, 1), feet, strict=True):
        knee = (hip + foot) / 2 + [0.2, side * 0.02, 0.08]
        thigh = hip + np.array([0, side * 0.09, 0])
        parts.append(figures.limb(thigh, knee, foot, (0.09, 0.055), trousers))
        hand = grip * [1, side, 1]
        elbow = (shoulder + hand) / 2 + [-0.03, side * 0.08, -0.08]
        arm = shoulder + np.array([0, side * 0.17, -0.02])
        parts.append(figures.limb(arm, elbow, hand, (0.055, 0.04), cloth))
    if rng.random() < 0.3:
        x = hip[0]
        z = hip[2]
        parts.append(box((x - 0.18, -0.16, z + 0.12), (x + 0.04, 0.16, z + 0.52), cloth))
    return parts


def head(hip: Array, lean: float, size: float, skin: Skin) -> Mesh:
    """Return the head of a person on a saddle, or a helmet."""
    centre = hip + np.array([lean + 0.08, 0, 0.74 - 0.3 * lean])
    return ellipsoid(centre, np.array([0.11, 0.09, 0.14]) * size, skin)


def bicyclist(rng: Rng) -> Mesh:
    """Return a bicycle with its rider."""
    hip = np.array([-0.2, 0, 0.98])
    lean = rng.uniform(0.08, 0.4)
    turn = rng.uniform(0, 2 * np.pi)
    angle = turn + np.array([0, np.pi])
    feet = np.stack(
        [-0.05 + 0.16 * np.cos(angle), np.array([-0.13, 0.13]), 0.3 + 0.16 * np.sin(angle)], -1
    )
    body = seated(rng, presets.BICYCLIST, hip, lean, feet, np.array([0.3, 0.25, 1.02]))
    skin = Skin(presets.BICYCLIST, Material.SKIN)
    return merge([bicycle(rng, presets.BICYCLIST), *body, head(hip, lean, 1.0, skin)])


def motorcyclist(rng: Rng) -> Mesh:
    """Return a motorcycle with one or two riders in helmets."""
    parts = [motorcycle(rng, presets.MOTORCYCLIST)]
    helmet = dark_paint(rng, presets.MOTORCYCLIST)
    for n in range(2 if rng.random() < 0.15 else 1):
        hip = np.array([-0.25 - 0.35 * n, 0, 0.87 + 0.06 * n])
        lean = rng.uniform(0.05, 0.35)
        feet = np.array([[0.0, -0.2, 0.36], [0.0, 0.2, 0.36]]) - [0.3 * n, 0, 0]
        grip = np.array([0.3 - 0.5 * n, 0.3, 1.02])
        parts += seated(rng, presets.MOTORCYCLIST, hip, lean, feet, grip)
        parts.append(head(hip, lean, 1.35, helmet))
    return merge(parts)
