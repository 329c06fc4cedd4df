# SPDX-License-Identifier: MIT
"""Objects of a street as meshes, each in a local frame: metres, the ground at z = 0.

Vehicles, cycles and people: x forward, y left, the middle of the footprint at the origin. Other
objects: x along the street, y away from it; long objects begin at x = 0, front walls are at y = 0.
"""
