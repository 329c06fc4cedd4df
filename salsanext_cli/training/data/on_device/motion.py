# SPDX-License-Identifier: MIT
"""Augmentations of the points of each scan of a batch: moved, thinned out, with other intensities.

Turn, shift, flip and another mounting are one affine map of each scan.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.records import Double
from salsanext_cli.training.data.augment import MAX_DROPPED_SHARE, SHIFT_HIGH_M, SHIFT_LOW_M
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.on_device.point_batch import PointBatch
from salsanext_cli.training.data.other_sensors import (
    LOG_GAIN,
    LOG_GAMMA,
    LOWERED_M,
    MAX_JITTER_M,
    OFFSET,
    RAISED_M,
    RANGE_POWER,
    RESPONSE_RANGE_M,
    TILT_DEG,
)
from salsanext_cli.training.recipe import Recipe


def augment(batch: PointBatch, scans: int, recipe: Recipe, random: BatchRandom) -> PointBatch:
    """Return the points of S scans moved, thinned out and jittered, each scan by chance."""
    turn = np.broadcast_to(np.eye(3), (scans, 3, 3))
    offset = np.zeros((scans, 3))
    if recipe.rotate:
        angle = random.host.uniform(-np.pi, np.pi, scans)
        turn = turns(np.where(random.happens(recipe.rotate, scans), angle, 0))
    if recipe.shift:
        moved = random.host.uniform(SHIFT_LOW_M, SHIFT_HIGH_M, (scans, 3))
        offset = moved * random.happens(recipe.shift, scans)[:, None]
    if recipe.flip:
        mirror = np.where(random.happens(recipe.flip, scans)[:, None], [1, -1, 1], 1)
        turn = turn * mirror[:, None]
        offset = offset * mirror
    if recipe.mount:
        is_mounted = random.happens(recipe.mount, scans)
        tilt = tilts(
            np.where(is_mounted, np.radians(random.host.normal(0, TILT_DEG, scans)), 0),
            random.host.uniform(0, 2 * np.pi, scans),
        )
        turn = turn @ tilt
        offset = (offset[:, None] @ tilt)[:, 0]
        offset[:, 2] += np.where(is_mounted, random.host.uniform(-RAISED_M, LOWERED_M, scans), 0)
    points = mapped(batch, random.put(turn), random.put(offset))
    if recipe.jitter:
        deviation = random.host.uniform(0, MAX_JITTER_M, scans)
        deviation *= random.happens(recipe.jitter, scans)
        noise = random.normal(*points.shape)
        points = points + batch.per_point(random.put(deviation))[:, None] * noise
    is_shown = batch.is_shown
    if recipe.drop:
        share = random.host.uniform(0, MAX_DROPPED_SHARE, scans)
        share *= random.happens(recipe.drop, scans)
        is_shown = is_shown & (random.uniform(len(points)) >= batch.per_point(random.put(share)))
    return replace(batch, points=points, is_shown=is_shown)


def turns(angles: Double) -> Double:
    """Return the maps of row vectors, (…, 3, 3), that turn counter-clockwise about z, radians."""
    turn = np.zeros((*angles.shape, 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angles)
    turn[..., 0, 1] = np.sin(angles)
    turn[..., 1, 0] = -np.sin(angles)
    turn[..., 2, 2] = 1
    return turn


def tilts(angles: Double, azimuths: Double) -> Double:
    """Return the maps of row vectors, (S, 3, 3), that turn about level axes.

    Parameters
    ----------
    angles : (S,) float64
        Angles of the rotations in radians.
    azimuths : (S,) float64
        Azimuths of their axes in radians.
    """
    # The axis becomes x, the map turns about x, and x becomes the axis again.
    turn = np.zeros((len(angles), 3, 3))
    turn[:, 0, 0] = 1
    turn[:, 1, 1] = turn[:, 2, 2] = np.cos(angles)
    turn[:, 1, 2] = np.sin(angles)
    turn[:, 2, 1] = -np.sin(angles)
    return turns(-azimuths) @ turn @ turns(azimuths)


def mapped(batch: PointBatch, turn: Tensor, offset: Tensor) -> Tensor:
    """Return the points of scans under affine maps.

    Parameters
    ----------
    batch : PointBatch
        P points of S scans.
    turn : (S, 3, 3) float32
        Maps of row vectors.
    offset : (S, 3) float32
        Offsets in metres, added after the maps.

    Returns
    -------
    (P, 3) float32
    """
    return turned(batch, turn) + batch.per_point(offset)


def turned(batch: PointBatch, turn: Tensor) -> Tensor:
    """Return the points of scans, (P, 3), under linear maps of row vectors, (S, 3, 3)."""
    x, y, z = batch.points[:, None].unbind(dim=2)
    x_row, y_row, z_row = batch.per_point(turn).unbind(dim=1)
    return torch.addcmul(torch.addcmul(x * x_row, y, y_row), z, z_row)


def change_intensity(
    batch: PointBatch, scans: int, bright: float, chance: float, random: BatchRandom
) -> PointBatch:
    """Return the points of S scans with other intensities, each scan by chance.

    They are gain · i^gamma · (range / 10 m)^power + offset, in units of the bright intensity.
    """
    if not chance:
        return batch
    gain, gamma = np.exp(random.host.normal(0, [[LOG_GAIN], [LOG_GAMMA]], (2, scans)))
    power, offset = random.host.normal(0, [[RANGE_POWER], [OFFSET]], (2, scans))
    gain, gamma, power, offset = map(random.put, (gain, gamma, power, offset))
    is_changed = random.put(random.happens(chance, scans), torch.bool)
    response = (batch.points.norm(dim=1) / RESPONSE_RANGE_M) ** batch.per_point(power)
    positive = batch.intensity.clamp_min(0) / bright
    law = batch.per_point(gain) * positive ** batch.per_point(gamma) * response
    changed = bright * (law + batch.per_point(offset))
    intensity = torch.where(batch.per_point(is_changed), changed, batch.intensity)
    return replace(batch, intensity=intensity)
