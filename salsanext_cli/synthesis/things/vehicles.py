# SPDX-License-Identifier: MIT
"""Vehicles with at least four wheels, by their frequencies in a street; cars."""

from collections.abc import Mapping

import numpy as np

from salsanext_cli.synthesis import presets
from salsanext_cli.synthesis.mesh import Mesh, Rng, Skin, box, merge
from salsanext_cli.synthesis.presets import CAR, Material
from salsanext_cli.synthesis.things.bodywork import dark_paint, fittings, shell, wheels
from salsanext_cli.synthesis.things.buses import bus
from salsanext_cli.synthesis.things.other_vehicles import other_vehicle
from salsanext_cli.synthesis.things.trucks import truck


def vehicle(rng: Rng, shares: Mapping[str, float]) -> Mesh:
    """Return a car, truck, bus or other vehicle with the relative frequencies of a street."""
    makers = {"car": car, "truck": truck, "bus": bus, "other": other_vehicle}
    return makers[presets.weighted_choice(rng, shares)](rng)


def length_of(mesh: Mesh) -> float:
    """Return the length of a vehicle in its own frame, metres."""
    return float(np.ptp(mesh.vertices[:, 0]))


def car(rng: Rng) -> Mesh:
    """Return a car of one of several shapes, sizes and paints."""
    body = presets.CARS[rng.integers(len(presets.CARS))]
    stretch = rng.uniform([0.93, 0.96, 0.96], [1.07, 1.03, 1.05])
    track = (body.width / 2 + 0.005) * stretch[1]
    axles = [0.31 * body.length * stretch[0], -0.30 * body.length * stretch[0]]
    parts = [
        shell(body, dark_paint(rng, CAR), stretch),
        *wheels(CAR, axles, track, body.wheel, 0.2),
        *fittings(body, CAR, stretch),
    ]
    floor = Skin(CAR, Material.RUBBER)
    reach = body.length * 0.45
    parts.append(box((-reach, -0.7, body.bottom - 0.04), (reach, 0.7, body.bottom + 0.1), floor))
    if rng.random() < 0.15:
        top = body.profile[:, 2].max() * stretch[2]
        parts.append(box((-0.9, -0.5, top + 0.05), (0.8, 0.5, top + 0.3), floor))
    return merge(parts)
