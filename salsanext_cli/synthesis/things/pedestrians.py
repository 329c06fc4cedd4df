# SPDX-License-Identifier: MIT
"""People on foot, alone or with an umbrella, a pram, a suitcase, a walking frame or a dog.

What a person carries or pushes has the label of the person; a dog is another object.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, ellipsoid, loft, merge, tube
from salsanext_cli.synthesis.presets import CLUTTER, PERSON, Material
from salsanext_cli.synthesis.things import figures, people

STEEL = Skin(PERSON, Material.METAL, 0.8)
TYRE = Skin(PERSON, Material.RUBBER, 2.0)
CANOPY = ((1.0, 0.0), (0.7, 0.14), (0.05, 0.22))
"""Rings of an umbrella: share of its radius, and height above its edge in metres."""
CANOPY_Y_M = 0.1  # Middle of an umbrella, left of the person
UMBRELLA_HAND_M = (0.22, 0.17)  # x and y of the hand that carries it
UMBRELLA_HAND_BELOW_HEAD_M = 0.75


def walker(rng: Rng) -> Mesh:
    """Return a person who walks along x, alone or with something."""
    frequencies = {name: company.frequency for name, company in COMPANIES.items()}
    return COMPANIES[presets.weighted_choice(rng, frequencies)].make(rng)


def bystander(rng: Rng) -> Mesh:
    """Return a person who stays, in any posture, or one who walks."""
    if rng.random() < 0.5:
        return figures.posed(rng)
    return people.person(rng) if rng.random() < 0.5 else walker(rng)


def with_umbrella(rng: Rng) -> Mesh:
    """Return a person below an open umbrella."""
    body = figures.figure(rng, figures.draw_stance(rng, "walking"), ("carrying", "hanging"))
    top = float(body.vertices[:, 2].max())
    cloth = Skin.random(rng, PERSON, Material.CLOTH, 0.3, 1.3)
    radius = rng.uniform(0.42, 0.62)
    low = top - rng.uniform(0.0, 0.1)
    x = rng.uniform(0.0, 0.2)
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    rings = []
    for share, height in CANOPY:
        around = share * radius * np.stack([np.cos(angle), np.sin(angle)], -1)
        rings.append(np.column_stack([around + [x, CANOPY_Y_M], np.full(8, low + height)]))
    hand = [*UMBRELLA_HAND_M, top - UMBRELLA_HAND_BELOW_HEAD_M]
    tip = [x, CANOPY_Y_M, low + CANOPY[-1][1]]
    stick = tube([hand, tip], 0.012, STEEL, 4)
    return merge([body, loft(np.array(rings), cloth), stick])


def _pushing(rng: Rng) -> Mesh:
    return figures.figure(rng, figures.draw_stance(rng, "walking"), ("pushing", "pushing"))


def _wheel(x: float, y: float, radius: float) -> Mesh:
    return tube([[x, y - 0.02, radius], [x, y + 0.02, radius]], radius, TYRE, 8)


def with_pram(rng: Rng) -> Mesh:
    """Return a person who pushes a pram or a pushchair."""
    body = _pushing(rng)
    cloth = Skin.random(rng, PERSON, Material.CLOTH, 0.3, 1.2)
    x = rng.uniform(0.75, 0.9)
    hood = rng.uniform(0.0, 0.45)
    parts = [body, ellipsoid((x + 0.1, 0, 0.66), (0.42, 0.2, 0.2), cloth)]
    if hood > 0.1:
        parts.append(ellipsoid((x - 0.1, 0, 0.85), (0.22, 0.22, 0.22 + hood / 4), cloth))
    for y in (-0.24, 0.24):
        parts += [_wheel(x - 0.2, y, 0.16), _wheel(x + 0.4, y, 0.12)]
        parts.append(tube([[0.45, y, 1.0], [x + 0.3, y, 0.3]], 0.018, STEEL, 4))
        parts.append(tube([[x - 0.2, y, 0.16], [x + 0.2, y, 0.6]], 0.018, STEEL, 4))
    parts.append(tube([[0.45, -0.24, 1.0], [0.45, 0.24, 1.0]], 0.02, STEEL, 4))
    return merge(parts)


def with_suitcase(rng: Rng) -> Mesh:
    """Return a person who pulls a suitcase on wheels."""
    shell = Skin.random(rng, PERSON, Material.PAINT, 0.3, 1.2)
    half = rng.uniform(0.15, 0.25)
    high = rng.uniform(0.5, 0.75)
    case = box((-0.13, -half, 0.06), (0.13, half, high), shell)
    handle = tube([[0, 0, high], [0, 0, 1.0]], 0.02, STEEL, 4)
    return merge([figures.walking(rng), merge([case, handle]).moved((-0.45, -0.28, 0))])


def with_frame(rng: Rng) -> Mesh:
    """Return a person behind a walking frame or a trolley."""
    parts = [_pushing(rng)]
    basket = Skin.random(rng, PERSON, Material.METAL, 0.5, 1.2)
    for y in (-0.27, 0.27):
        parts.append(tube([[0.4, y, 0.92], [0.75, y, 0.1]], 0.02, STEEL, 4))
        parts.append(tube([[0.55, y, 0.55], [0.3, y, 0.1]], 0.02, STEEL, 4))
        parts += [_wheel(0.75, y, 0.1), _wheel(0.3, y, 0.1)]
    parts.append(box((0.48, -0.25, 0.5), (0.8, 0.25, 0.72), basket))
    return merge(parts)


def in_wheelchair(rng: Rng) -> Mesh:
    """Return a person in a wheelchair."""
    stance = figures.draw_stance(rng, "sitting")
    cloth = Skin.random(rng, PERSON, Material.CLOTH, 0.2, 0.9)
    parts = [
        figures.figure(rng, stance, ("carrying", "carrying")),
        box((-0.22, -0.24, 0.36), (0.25, 0.24, 0.42), cloth),
        box((-0.26, -0.24, 0.42), (-0.2, 0.24, 0.95), cloth),
    ]
    for y in (-0.3, 0.3):
        parts += [_wheel(-0.05, y, 0.3), _wheel(0.38, y, 0.09)]
    return merge(parts)


def with_dog(rng: Rng) -> Mesh:
    """Return a person with a dog on a leash; the dog is no person."""
    fur = Skin.random(rng, CLUTTER, Material.CLOTH, 0.2, 1.2)
    back = rng.uniform(0.22, 0.6)
    long = back * 0.7
    thick = back * 0.28
    height = back - thick / 2
    parts = [ellipsoid((0, 0, height), (long, thick * 0.8, thick), fur)]
    head = (long * 1.15, 0, back + thick * 0.7)
    parts.append(ellipsoid(head, (thick, thick * 0.6, thick * 0.6), fur))
    for x in (-long * 0.75, long * 0.7):
        for y in (-thick * 0.5, thick * 0.5):
            parts.append(tube([[x, y, 0.0], [x, y, height]], thick * 0.22, fur, 5))
    parts.append(tube([[-long, 0, height], [-long * 1.4, 0, back + thick]], thick * 0.15, fur, 4))
    place = np.array([rng.uniform(-0.3, 0.9), rng.choice([-1, 1]) * rng.uniform(0.45, 0.8), 0])
    dog = merge(parts).moved(place, rng.uniform(-0.6, 0.6))
    collar = place + [long * 0.9, 0, back]
    hand = np.array([0.1, 0.2 * np.sign(place[1]), 0.85])
    leash = tube(np.stack([hand, collar]), 0.01, fur, 4)
    return merge([figures.walking(rng), dog, leash])


def with_child(rng: Rng) -> Mesh:
    """Return a person with a child on the shoulders or by the hand."""
    grown = figures.walking(rng)
    child = people.person(rng).scaled(0.6)
    if rng.random() < 0.3:
        seated = figures.figure(rng, figures.draw_stance(rng, "sitting"), ("carrying", "carrying"))
        top = float(grown.vertices[:, 2].max())
        return merge([grown, seated.scaled(0.55).moved((-0.08, 0, top - 0.5))])
    return merge([grown, child.moved((rng.normal(0, 0.1), rng.choice([-1, 1]) * 0.42, 0))])


@dataclass(frozen=True, slots=True, kw_only=True)
class Company:
    """What accompanies a person on foot."""

    frequency: float  # Relative to the others
    make: Callable[[Rng], Mesh]  # Returns the person with it


COMPANIES = {
    "alone": Company(frequency=7.0, make=figures.walking),
    "umbrella": Company(frequency=0.8, make=with_umbrella),
    "pram": Company(frequency=0.9, make=with_pram),
    "suitcase": Company(frequency=0.5, make=with_suitcase),
    "frame": Company(frequency=0.3, make=with_frame),
    "wheelchair": Company(frequency=0.3, make=in_wheelchair),
    "dog": Company(frequency=0.8, make=with_dog),
    "child": Company(frequency=0.5, make=with_child),
}
"""Companies of people on foot, by name."""
