# SPDX-License-Identifier: MIT
"""Augmentations of the paper, on points, before projecting.

Each happens on its own with its own probability. Because points move and not pixels, range, x, y
and z of the range image stay consistent.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import TrainIds
from salsanext_cli.records import Float, Scan
from salsanext_cli.training.recipe import Recipe

LabelledScan = tuple[Scan, TrainIds]
"""A scan and the train ids of its points, (N,) uint8."""

SHIFT_LOW_M = (-5.0, -3.0, -1.0)
SHIFT_HIGH_M = (5.0, 3.0, 0.0)
MAX_DROPPED_SHARE = 0.5
"""Bounds of the shift along x, y and z, and of the share of points that are dropped."""


def augment(labelled: LabelledScan, recipe: Recipe, random: np.random.Generator) -> LabelledScan:
    """Return a changed copy of a labelled scan.

    The points are turned about z by any angle; moved by up to ±5 m forward, ±3 m sideways and 1 m
    down; mirrored left and right; and a uniform share of them, at most half, is dropped. The recipe
    holds the probability of each.
    """
    scan, labels = labelled
    chances = (recipe.rotate, recipe.shift, recipe.flip, recipe.drop)
    rotated, shifted, flipped, dropped = random.random(4) < chances
    points, intensity = scan.points, scan.intensity
    if rotated:
        points = rotate(points, random.uniform(-np.pi, np.pi))
    if shifted:
        points = shift(points, random.uniform(SHIFT_LOW_M, SHIFT_HIGH_M))
    if flipped:
        points = points * np.array([1, -1, 1], np.float32)
    if dropped:
        count = int(len(scan) * random.uniform(0, MAX_DROPPED_SHARE))
        kept = np.sort(random.permutation(len(scan))[count:])
        points, intensity, labels = points.take(kept, 0), intensity[kept], labels[kept]
    return Scan(points, intensity), labels


def rotate(points: Float, angle: float) -> Float:
    """Turn points (N, 3) counter-clockwise about z by an angle in radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], np.float32)
    with np.errstate(invalid="ignore"):
        turned: Float = points @ turn
    return turned


def shift(points: Float, offset: npt.NDArray[np.float64]) -> Float:
    """Move points (N, 3) by (3,) metres; those at the origin measure nothing and stay."""
    x, y, z = points.T != 0
    moved: Float = points + (x | y | z)[:, None] * offset.astype(np.float32)
    return moved
