# SPDX-License-Identifier: MIT
"""Mixing of the scans of a batch by checkerboards, and pasting of rare points."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.records import Double
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.training.data.augment import (
    CLEAR_RADIUS_M,
    KINDS,
    MAX_BANDS,
    MAX_SECTOR_PAIRS,
    MIN_BANDS,
    PASTED_COPIES,
)
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.on_device.drawn_scans import DrawnScans
from salsanext_cli.training.data.on_device.motion import turned, turns
from salsanext_cli.training.data.on_device.point_batch import PointBatch, joined


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Checkerboards:
    """Checkerboards of B images over the directions of the rays, as `augment.Checkerboard`.

    A board changes its colour at every border: of bands, a cone, or of two sectors, a plane.

    Attributes
    ----------
    slopes : (B, MAX_BANDS - 1) float64
        Slopes of the cones, infinite for none.
    planes : (B, MAX_SECTOR_PAIRS, 2) float64
        Cosine and sine of the azimuths of the planes, 0 for none.
    """

    slopes: Double
    planes: Double

    @classmethod
    def random(cls, count: int, sensor: Sensor, random: np.random.Generator) -> "Checkerboards":
        """Draw bands, sectors or boxes with equal chance, their number and azimuth."""
        in_bands, in_sectors = np.array(KINDS)[random.integers(len(KINDS), size=count)].T
        bands = np.where(in_bands, random.integers(MIN_BANDS, MAX_BANDS + 1, count), 1)
        pairs = np.where(in_sectors, random.integers(1, MAX_SECTOR_PAIRS + 1, count), 0)
        azimuths = random.uniform(-np.pi, np.pi, count)
        return cls.from_numbers(bands, pairs, azimuths, sensor)

    @classmethod
    def from_numbers(
        cls, bands: Double, pairs: Double, azimuths: Double, sensor: Sensor
    ) -> "Checkerboards":
        """Return boards by their numbers of bands and of pairs of sectors, and an azimuth, (B,)."""
        border = np.arange(1, MAX_BANDS)
        extent = sensor.fov_up - sensor.fov_down
        inclination = np.radians(sensor.fov_down + extent * border / bands[:, None])
        is_border = border < bands[:, None]
        slopes = np.where(is_border, np.tan(np.where(is_border, inclination, 0)), np.inf)
        plane = np.arange(MAX_SECTOR_PAIRS)
        angle = azimuths[:, None] + plane * math.pi / np.maximum(pairs, 1)[:, None]
        planes = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        return cls(slopes=slopes, planes=np.where((plane < pairs[:, None])[..., None], planes, 0))

    def odd(self, points: Tensor, image_of_point: Tensor, random: BatchRandom) -> Tensor:
        """Return whether points (P, 3) of images, (P,) int64, lie in odd cells, (P,) bool."""
        x, y, z = points.unbind(dim=1)
        flat = torch.hypot(x, y)
        odd = torch.zeros_like(x, dtype=torch.bool)
        for slope in random.put(self.slopes).unbind(dim=1):
            odd ^= z > flat * slope.index_select(0, image_of_point)
        for plane in random.put(self.planes).unbind(dim=1):
            cosine, sine = plane.index_select(0, image_of_point).unbind(dim=1)
            odd ^= y * cosine > x * sine
        return odd


def mix(batch: PointBatch, drawn: DrawnScans, sensor: Sensor, random: BatchRandom) -> PointBatch:
    """Return the points of scans in the cells of their images; those in other cells are hidden.

    The first scan of an image has the even cells of its board, a mixed one the odd cells. A scan
    that is not mixed with another has all cells.
    """
    images = drawn.image_of_scan
    mixed_images = images[drawn.is_mixed]
    if not len(mixed_images):
        return batch
    boards = Checkerboards.random(int(images.max()) + 1, sensor, random.host)
    image_of_point = batch.per_point(random.put(images, torch.int64))
    odd = boards.odd(batch.points, image_of_point, random)
    is_pasted = np.arange(len(images)) >= len(drawn.whole)
    has_all_cells = is_pasted | ~np.isin(images, mixed_images)
    in_cell = odd == batch.per_point(random.put(drawn.is_mixed, torch.bool))
    in_cell |= batch.per_point(random.put(has_all_cells, torch.bool))
    return replace(batch, is_shown=batch.is_shown & in_cell)


def paste(batch: PointBatch, start: int, scans: int, random: BatchRandom) -> PointBatch:
    """Return points with copies of the pasted ones, turned about z, in place of these.

    Parameters
    ----------
    batch : PointBatch
        P points of S scans.
    start : int
        Number of points before those of the pasted scans.
    scans : int
        S.
    random : BatchRandom
        Random numbers of the batch.

    Returns
    -------
    PointBatch
    """
    whole = batch.part(slice(0, start))
    pasted = batch.part(slice(start, None))
    if not len(pasted.points):
        return whole
    is_clear = torch.hypot(pasted.points[:, 0], pasted.points[:, 1]) > CLEAR_RADIUS_M
    pasted = replace(pasted, is_shown=pasted.is_shown & is_clear)
    copies = []
    for _ in range(PASTED_COPIES):
        turn = random.put(turns(random.host.uniform(-np.pi, np.pi, scans)))
        copies.append(replace(pasted, points=turned(pasted, turn)))
    return joined([whole, *copies])
