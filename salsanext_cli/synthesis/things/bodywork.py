# SPDX-License-Identifier: MIT
"""Parts of vehicles: paint, bodies with windows, wheels, lamps and mirrors."""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, Skin, box, disc, faces, loft, merge, tube
from salsanext_cli.synthesis.presets import Material, Numbers


def dark_paint(rng: Rng, label: int) -> Skin:
    """Draw the paint of a vehicle, mostly dark in the infrared."""
    bounds = ((0.0, 0.09), (0.1, 0.5), (0.5, 1.0), (1.0, 1.6))
    return Skin.random(rng, label, Material.PAINT, *bounds[rng.choice(4, p=(0.6, 0.14, 0.16, 0.1))])


def shell(body: Numbers, paint: Skin, stretch: Array) -> Mesh:
    """Return a body without wheels: cross-sections from front to rear, and windows."""
    profile = body.profile
    x = (0.5 - profile[:, 0]) * body.length
    half = body.width / 2 * np.where(profile[:, 0] % 1.0 == 0, 0.86, 1.0)
    belt = profile[:, 1]
    roof = profile[:, 2]
    top = half * profile[:, 3]
    sill = np.full(len(x), body.bottom)
    middle = (sill + belt) / 2
    y = np.stack([-half * 0.94, -half, -half * 0.96, -top, top, half * 0.96, half, half * 0.94], -1)
    z = np.stack([sill, middle, belt, roof, roof, belt, middle, sill], -1)
    sections = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1)
    skin = loft(sections, paint)
    windows = np.zeros((len(x) - 1, y.shape[1]), bool)
    windows[np.ix_(body.cabin, (2, 4))] = windows[np.ix_(body.screens, (2, 3, 4))] = True
    glass = np.tile(windows.ravel(), 2)
    skin.materials[glass] = Material.GLASS
    skin.shades[glass] = 0.8
    return merge([skin, faces(sections[[0, -1]], paint)]).scaled(stretch)


def wheels(label: int, axles: list[float], track: float, radius: float, wide: float) -> list[Mesh]:
    """Return wheels at both ends of axles: a tyre with a rim on its outside."""
    tyre = Skin(label, Material.RUBBER)
    rim = Skin(label, Material.METAL, 0.9)
    parts = []
    for x in axles:
        for side in (-1, 1):
            inner = side * (track - wide)
            outer = side * track
            parts.append(tube([[x, inner, radius], [x, outer, radius]], radius, tyre, 14))
            parts.append(disc((x, outer - side * 0.02, radius), radius * 0.97, tyre))
            parts.append(disc((x, outer + side * 0.01, radius), radius * 0.66, rim))
    return parts


def fittings(body: Numbers, label: int, stretch: Array) -> list[Mesh]:
    """Return number plates, lamps, reflectors and mirrors of a body."""
    lamp = Skin(label, Material.LAMP)
    retro = Skin(label, Material.RETRO)
    mirror = Skin(label, Material.PAINT, 0.4)
    front = body.length / 2 * stretch[0]
    rear = -body.length / 2 * stretch[0]
    half = body.width / 2 * stretch[1]
    height = body.profile[1, 1] * stretch[2]
    parts = [
        box((front - 0.02, -0.26, 0.38), (front + 0.015, 0.26, 0.49), retro),
        box((rear - 0.015, -0.26, 0.62), (rear + 0.02, 0.26, 0.73), retro),
    ]
    for side in (-1, 1):
        x = body.length * 0.16
        a = side * (half - 0.36)
        b = side * (half - 0.1)
        c = side * half
        parts += [
            box((front - 0.3, a, height - 0.16), (front - 0.02, b, height), lamp),
            box((rear - 0.01, a, height + 0.05), (rear + 0.2, b, height + 0.2), lamp),
            box((rear - 0.02, a, 0.45), (rear + 0.02, b, 0.5), retro),
            box((x, c, height + 0.2), (x + 0.12, side * (half + 0.16), height + 0.36), mirror),
        ]
    return parts
