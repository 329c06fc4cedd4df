# SPDX-License-Identifier: MIT
"""Raw SemanticKITTI ids of the classes of a street."""

from __future__ import annotations

CAR, BICYCLE, TRUCK, PERSON, BICYCLIST = 10, 11, 18, 30, 31
ROAD, PARKING, SIDEWALK, MARKING, TERRAIN = 40, 44, 48, 60, 72
BUILDING, FENCE, STRUCTURE = 50, 51, 52
VEGETATION, TRUNK = 70, 71
POLE, SIGN, CLUTTER = 80, 81, 99

MOVING = {CAR: 252, BICYCLIST: 253, PERSON: 254, TRUCK: 258}
"""The raw id of a class while it moves."""

ABSENT = ("motorcycle", "other-vehicle", "motorcyclist", "other-ground")
"""Classes that the street never holds."""
