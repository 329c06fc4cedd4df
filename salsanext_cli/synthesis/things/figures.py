# SPDX-License-Identifier: MIT
"""Figures of people: a trunk at the height of the hips, legs in a stance, and arms in a gesture."""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import (
    Array,
    Mesh,
    Rng,
    Skin,
    box,
    ellipsoid,
    merge,
    rotation,
    tube,
)
from salsanext_cli.synthesis.presets import PERSON, Material

HIP = 0.52
SHOULDER = 0.82
SEAT = 0.28
"""Heights of standing hips and shoulders and of a seat, as shares of the person's height."""
CHILD_SHARE = 0.12
COAT_SHARE = 0.3
GESTURES = {
    "carrying": ((0.0, 0.15, 0.13), (0.14, 0.1, 0.12)),
    "telephone": ((0.07, 0.16, 0.16), (0.04, 0.09, 0.38)),
    "spread": ((0.0, 0.25, 0.29), (0.0, 0.4, 0.3)),
    "raised": ((0.05, 0.16, 0.42), (0.05, 0.14, 0.56)),
    "folded": ((0.02, 0.15, 0.14), (0.12, -0.04, 0.17)),
    "akimbo": ((-0.03, 0.23, 0.15), (0.02, 0.11, 0.03)),
    "pushing": ((0.08, 0.15, 0.14), (0.27, 0.11, 0.12)),
    "pointing": ((0.14, 0.13, 0.28), (0.3, 0.12, 0.31)),
}
"""Elbow and left hand above the hips; lengths are shares of the person's height."""
GESTURE_SHARES = {
    "hanging": 5.0, "carrying": 1.2, "telephone": 0.8, "spread": 0.4, "raised": 0.3,
    "folded": 0.6, "akimbo": 0.5, "pointing": 0.4,
}  # fmt: skip
STANCE_SHARES = {"walking": 3.0, "standing": 4.0, "sitting": 1.0, "crouching": 1.2, "bending": 1.2}


@dataclass(frozen=True, slots=True, kw_only=True)
class Stance:
    """Position of hips and legs of a person 1 m tall; rows are the left and the right leg."""

    hips: float  # Height
    lean: float  # Of the trunk, forwards, radians
    knees: Array  # (2, 3)
    feet: Array  # (2, 3)


def draw_stance(rng: Rng, name: str) -> Stance:
    """Draw a stance by its name, one of `STANCE_SHARES`."""
    aside = np.array([0.05, -0.05])
    if name == "walking":
        stride = rng.uniform(0.05, 0.2)
        return _upright(stride * np.array([1, -1]), aside, rng.uniform(-0.02, 0.1))
    if name == "standing":
        spread = aside * rng.uniform(0.8, 2.4)
        return _upright(rng.normal(0, 0.02, 2), spread, rng.uniform(-0.06, 0.08))
    if name == "bending":
        return _upright(rng.normal(0, 0.06, 2), aside * 1.5, rng.uniform(0.5, 1.4))
    if name == "sitting":
        knees = np.stack([[0.26, 0.26], aside * 1.2, [SEAT, SEAT]], -1)
        feet = np.stack([rng.uniform(0.2, 0.36, 2), aside * 1.2, [0.02, 0.02]], -1)
        return Stance(hips=SEAT, lean=rng.uniform(-0.15, 0.35), knees=knees, feet=feet)
    hips = rng.uniform(0.14, 0.26)
    knees = np.stack([[0.2, 0.12], aside * 1.6, [hips + 0.1, rng.uniform(0.05, hips)]], -1)
    feet = np.stack([[0.06, -0.06], aside * 1.6, [0.03, 0.03]], -1)
    return Stance(hips=hips, lean=rng.uniform(0.1, 0.8), knees=knees, feet=feet)


def _upright(ahead: Array, aside: Array, lean: float) -> Stance:
    knees = np.stack([ahead * 0.5 + 0.03, aside, [0.28, 0.28]], -1)
    feet = np.stack([ahead, aside, [0.03, 0.03]], -1)
    return Stance(hips=HIP, lean=lean, knees=knees, feet=feet)


def limb(start: Array, joint: Array, end: Array, radii: tuple[float, float], skin: Skin) -> Mesh:
    """Return an arm or a leg with a joint."""
    first, last = radii
    return tube([start, joint, end], [first, (first + last) / 2, last], skin)


def figure(rng: Rng, stance: Stance, gestures: tuple[str, str], label: int = PERSON) -> Mesh:
    """Return a person 1.1 to 1.95 m tall; the gestures are of the left and the right arm."""
    child = rng.random() < CHILD_SHARE
    height = float(rng.uniform(1.1, 1.5) if child else rng.uniform(1.55, 1.95))
    top = Skin.random(rng, label, Material.CLOTH, 0.3, 1.4)
    bottom = Skin.random(rng, label, Material.CLOTH, 0.3, 1.35)
    girth = rng.uniform(0.85, 1.3)
    upper = [*_trunk(girth, top, label), *_luggage(rng, label)]
    swing = 0.5 * (stance.feet[0, 0] - stance.feet[1, 0])
    for side, gesture in zip((1, -1), gestures, strict=True):
        upper.append(_arm(rng, side, gesture, -side * swing, girth, top))
    trunk = merge(upper)
    turned = Mesh(
        vertices=trunk.vertices @ rotation("y", stance.lean).T + [0, 0, stance.hips],
        triangles=trunk.triangles,
        labels=trunk.labels,
        materials=trunk.materials,
        shades=trunk.shades,
    )
    parts = [turned, *_legs(stance, bottom, label)]
    if stance.hips == HIP and rng.random() < COAT_SHARE:
        skirt = [[0, 0, 0.3], [0, 0, HIP + 0.04]]
        parts.append(tube(skirt, [0.13 * girth, 0.09 * girth], bottom, 9))
    return merge(parts).scaled(height)


def _trunk(girth: float, cloth: Skin, label: int) -> list[Mesh]:
    """Return head, neck and trunk above the hips."""
    bare = Skin(label, Material.SKIN)
    spine = [[0, 0, -0.03], [0.005, 0, 0.1], [0, 0, 0.24], [0, 0, SHOULDER + 0.02 - HIP]]
    trunk = tube(spine, np.array([0.085, 0.08, 0.098, 0.06]) * girth, cloth, 9)
    return [
        ellipsoid((0.01, 0, 0.935 - HIP), (0.062, 0.05, 0.075), bare),
        tube([[0, 0, 0.84 - HIP], [0, 0, 0.9 - HIP]], 0.033, bare, 6),
        trunk.scaled((0.8, 1.2, 1)),
    ]


def _arm(rng: Rng, side: int, gesture: str, swing: float, girth: float, cloth: Skin) -> Mesh:
    shoulder = np.array([0, side * 0.11 * girth, SHOULDER - 0.01 - HIP])
    mirrored = np.array([1, side, 1])
    if gesture == "hanging":
        raised = rng.uniform(0.0, 0.12)
        elbow = np.array([swing * 0.35, side * 0.14 * girth, 0.12])
        hand = np.array([swing * 0.8 + raised, side * 0.145 * girth, raised - 0.02])
    else:
        elbow, hand = (np.array(joint) * mirrored for joint in GESTURES[gesture])
        hand = hand + rng.normal(0, 0.02, 3)
    return limb(shoulder, elbow, hand, (0.034, 0.022), cloth)


def _legs(stance: Stance, cloth: Skin, label: int) -> list[Mesh]:
    parts = []
    for side, knee, foot in zip((1, -1), stance.knees, stance.feet, strict=True):
        hip = np.array([0, side * 0.05, stance.hips])
        parts.append(limb(hip, knee, foot, (0.055, 0.032), cloth))
        sole = foot + np.array([0.035, 0, -0.008])
        parts.append(ellipsoid(sole, (0.08, 0.03, 0.025), Skin(label, Material.RUBBER)))
    return parts


def _luggage(rng: Rng, label: int) -> list[Mesh]:
    """Return up to two of a rucksack, a bag on either side and a box in the arms."""
    bag = Skin.random(rng, label, Material.CLOTH, 0.3, 1.2)
    corners = (
        ((-0.17, -0.09, 0.06), (-0.07, 0.09, 0.28)),
        ((-0.1, 0.13, -0.22), (0.1, 0.19, -0.04)),
        ((0.08, -0.13, 0.03), (0.24, 0.13, 0.18)),
        ((-0.08, -0.19, -0.2), (0.08, -0.13, -0.02)),
    )
    kinds = set(rng.choice(5, 2, p=(0.15, 0.1, 0.05, 0.1, 0.6)).tolist()) - {len(corners)}
    return [box(*corners[kind], bag) for kind in kinds]


def draw_gestures(rng: Rng) -> tuple[str, str]:
    """Draw the gestures of the left and the right arm; most of them are alike."""
    first = presets.weighted_choice(rng, GESTURE_SHARES)
    second = first if rng.random() < 0.6 else presets.weighted_choice(rng, GESTURE_SHARES)
    return first, second


def posed(rng: Rng) -> Mesh:
    """Return a person in any stance with any gestures."""
    stance = draw_stance(rng, presets.weighted_choice(rng, STANCE_SHARES))
    return figure(rng, stance, draw_gestures(rng))


def walking(rng: Rng) -> Mesh:
    """Return a walking person with any gestures."""
    return figure(rng, draw_stance(rng, "walking"), draw_gestures(rng))
