# SPDX-License-Identifier: MIT
"""Surfaces: raw SemanticKITTI ids, materials, and how these reflect a 905 nm laser pulse.

The levels were set so that the intensity of each class spreads as it does in scans of an HDL-64E.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

CAR, BICYCLE, TRUCK, PERSON, BICYCLIST = 10, 11, 18, 30, 31
ROAD, PARKING, SIDEWALK, MARKING, TERRAIN = 40, 44, 48, 60, 72
BUILDING, FENCE, STRUCTURE = 50, 51, 52
VEGETATION, TRUNK = 70, 71
POLE, SIGN, CLUTTER = 80, 81, 99

MOVING = {CAR: 252, BICYCLIST: 253, PERSON: 254, TRUCK: 258}
"""The raw id of a class while it moves."""

ABSENT = ("motorcycle", "other-vehicle", "motorcyclist", "other-ground")
"""Classes that the street never holds."""


class Material(IntEnum):
    """Material of a surface."""

    ASPHALT = 0
    PAVING = 1
    GRASS = 2
    MARKING = 3
    PLASTER = 4
    BRICK = 5
    GLASS = 6
    LEAF = 7
    BARK = 8
    WOOD = 9
    METAL = 10
    PAINT = 11
    RUBBER = 12
    CLOTH = 13
    SKIN = 14
    RETRO = 15
    LAMP = 16


class Optics(NamedTuple):
    """Reflection by a material.

    Attributes
    ----------
    brightness : float
        Intensity that a surface facing the sensor at 15 m returns.
    texture : float
        Relative spread of the brightness from point to point.
    falloff : float
        Exponent of the cosine of the angle of incidence, near grazing.
    gloss : float
        Share of the pulses that a mirror-like surface sends elsewhere, the more the darker it is.
    roughness : float
        Standard deviation of the surface along the ray, metres.
    """

    brightness: float
    texture: float
    falloff: float
    gloss: float = 0.0
    roughness: float = 0.0


OPTICS: dict[Material, Optics] = {
    Material.ASPHALT: Optics(0.34, 0.14, 0.9, roughness=0.004),
    Material.PAVING: Optics(0.365, 0.12, 0.6, roughness=0.004),
    Material.GRASS: Optics(0.43, 0.16, 0.4, roughness=0.03),
    Material.MARKING: Optics(0.5, 0.15, 0.7, roughness=0.004),
    Material.PLASTER: Optics(0.47, 0.08, 0.3),
    Material.BRICK: Optics(0.43, 0.14, 0.3, roughness=0.004),
    Material.GLASS: Optics(0.06, 0.8, 0.5, gloss=1.0),
    Material.LEAF: Optics(0.43, 0.28, 0.25, roughness=0.04),
    Material.BARK: Optics(0.45, 0.2, 0.3, roughness=0.012),
    Material.WOOD: Optics(0.43, 0.16, 0.3, roughness=0.004),
    Material.METAL: Optics(0.32, 0.35, 0.5, gloss=0.1),
    Material.PAINT: Optics(0.34, 0.35, 0.9, gloss=0.3),
    Material.RUBBER: Optics(0.04, 0.5, 0.4, gloss=0.15),
    Material.CLOTH: Optics(0.52, 0.2, 0.3, roughness=0.012),
    Material.SKIN: Optics(0.5, 0.12, 0.3, roughness=0.005),
    Material.RETRO: Optics(0.95, 0.1, 0.2),
    Material.LAMP: Optics(0.6, 0.5, 0.3, gloss=0.2),
}


def optics_table() -> npt.NDArray[np.float64]:
    """Return the optics of all materials, (materials, 5) in the order of `Optics`."""
    return np.array([OPTICS[material] for material in Material])
