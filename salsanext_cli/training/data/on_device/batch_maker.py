# SPDX-License-Identifier: MIT
"""The way of a batch on a device: points of scans, augmented, mixed, projected, normalised.

The steps are those of `dataset.Samples` in their order, each for the whole batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.geometry.intensity import bright_intensity
from salsanext_cli.core.geometry.row_gaps import MORE_GAPS, fills_rows
from salsanext_cli.core.on_device.projection import project
from salsanext_cli.core.on_device.scan_batch import PointsOfScans
from salsanext_cli.core.records import CHANNELS, Indices
from salsanext_cli.core.sensors.sensor import ORIGIN, UP, Sensor
from salsanext_cli.training.data import other_sensors
from salsanext_cli.training.data.dataset import Batch, SampleKey, Samples
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.on_device.drawn_scans import draw_scans
from salsanext_cli.training.data.on_device.image_changes import (
    columns_of,
    drawn_rows,
    fill_rows,
    make_holes,
    row_gap_shares,
    window_columns,
)
from salsanext_cli.training.data.on_device.mixing import mix, paste
from salsanext_cli.training.data.on_device.motion import augment, change_intensity
from salsanext_cli.training.data.on_device.point_batch import PointBatch
from salsanext_cli.training.data.on_device.scan_store import ScanKey, ScanStore
from salsanext_cli.training.data.targets import target_mask

VIEWS = 256  # Sensors of sequences whose views are kept, since each is checked when it is made
ON_DEVICE = 3  # Part of the seed of batches; `dataset` and `learner` have the others


RANGE = CHANNELS.index("range")
INTENSITY = CHANNELS.index("intensity")
TRUTH = len(CHANNELS)  # Channel of the targets, which lose pixels and are filled as the others


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImagePoints:
    """Points of the images of a batch.

    Attributes
    ----------
    batch : PointBatch
        P points.
    image_of_point : (P,) int64
        Number of the image of each point.
    """

    batch: PointBatch
    image_of_point: Tensor


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BatchMaker:
    """Maker of batches from scans in memory.

    Attributes
    ----------
    samples : Samples
        Scans of this worker, sensor and recipe.
    store : ScanStore
        The scans in memory.
    keys : list of ScanKey
        Keys of the scans in the store, by index.
    device : torch.device
        Device of the training.
    rank : int
        Number of this worker.
    """

    samples: Samples
    store: ScanStore
    keys: Sequence[ScanKey]
    device: torch.device
    rank: int = 0

    def make(self, keys: Sequence[SampleKey]) -> Batch:
        """Return the samples with these keys.

        Returns
        -------
        images : (B, 5, H, W) float32
            Normalised images on the device.
        truth : (B, H, W) uint8
            Targets on the device.
        """
        recipe = self.samples.recipe
        seed = (recipe.seed, ON_DEVICE, self.rank, keys[0][0])
        random = BatchRandom.seeded(seed, self.device)
        index = np.array([index for _, index in keys], np.intp)
        views = self._views(index, random)
        images = projected(self._points(index, random), views)
        return self._windows(self._changed(images, views, random), random)

    def _views(self, index: Indices, random: BatchRandom) -> list[Sensor]:
        """Return the sensor that each image is projected for; all have one width."""
        recipe = self.samples.recipe
        width = None
        if recipe.image_widths:
            width = int(random.host.choice(recipe.image_widths))
        views = []
        for scan, is_other in zip(index, random.happens(recipe.view, len(index)), strict=True):
            source, file = self.samples.scan_at(int(scan))
            view = _view(source.sensor_of(file), width)
            views.append(other_sensors.other_view(view, random.host) if is_other else view)
        return views

    def _points(self, index: Indices, random: BatchRandom) -> ImagePoints:
        """Return the augmented points of the images of scans with these indices."""
        recipe = self.samples.recipe
        sensor = self.samples.sensor
        drawn = draw_scans(index, self.samples.plan.scan_counts, recipe, random)
        whole = [self.store.whole[self.keys[i]] for i in drawn.whole]
        pasted = [self.store.pasted[self.keys[i]] for i in drawn.pasted]
        batch = PointBatch.from_scans([*whole, *pasted], self.device)
        bright = bright_intensity(sensor)
        batch = change_intensity(batch, drawn.count, bright, recipe.intensity, random)
        batch = augment(batch, drawn.count, recipe, random)
        batch = mix(batch, drawn, sensor, random)
        batch = paste(batch, sum(map(len, whole)), drawn.count, random)
        images = random.put(drawn.image_of_scan, torch.int64)
        return ImagePoints(batch=batch, image_of_point=batch.per_point(images))

    def _changed(self, images: Tensor, views: Sequence[Sensor], random: BatchRandom) -> Tensor:
        """Return images (B, 6, H, W) with lost pixels and rows, filled gaps, without intensity."""
        recipe = self.samples.recipe
        trained = self.samples.sensor
        count = len(images)
        if recipe.holes:
            factors = random.host.uniform(0, other_sensors.MAX_HOLES, count)
            images = make_holes(images, factors * random.happens(recipe.holes, count), random)
        fills = [fills_rows(view, trained) for view in views]
        is_filled = random.put(fills, torch.bool)
        if recipe.fewer_beams:
            is_thinned = random.happens(recipe.fewer_beams, count)
            rows = drawn_rows(count, images.shape[2], random.host) | ~is_thinned[:, None]
            images = images * random.put(rows)[:, None, :, None]
            if trained.row_gaps is not None:
                has_gaps = row_gap_shares(images[:, 0]) > trained.row_gaps + MORE_GAPS
                is_filled = has_gaps.where(random.put(is_thinned, torch.bool), is_filled)
        if any(fills) or (recipe.fewer_beams and trained.row_gaps is not None):
            images = fill_rows(images, is_filled)
        if recipe.no_intensity:
            is_without = random.put(random.happens(recipe.no_intensity, count), torch.bool)
            mean = float(np.mean(trained.intensity_quantiles))
            is_mean = is_without[:, None, None] & (images[:, RANGE] > 0)
            images[:, INTENSITY] = images[:, INTENSITY].masked_fill(is_mean, mean)
        return images

    def _windows(self, images: Tensor, random: BatchRandom) -> Batch:
        """Return windows of images (B, 6, H, W), normalised, and their targets."""
        samples = self.samples
        recipe = samples.recipe
        scored = target_mask(samples.sources[0].space.scored, samples.sets, np.any)
        truth = images[:, TRUTH].byte()
        columns = window_columns(truth, scored, recipe.crop_width, recipe.crop_on_class, random)
        windows = columns_of(images, columns)
        statistics = random.put([samples.sensor.means, samples.sensor.stds])
        means = statistics[0, :, None, None]
        stds = statistics[1, :, None, None]
        normal = (windows[:, :TRUTH] - means) / stds
        is_empty = windows[:, RANGE : RANGE + 1] <= 0
        return normal.masked_fill(is_empty, 0), windows[:, TRUTH].byte()


@lru_cache(VIEWS)
def _view(sensor: Sensor, width: int | None) -> Sensor:
    """Return the sensor of scans in its frame, for images of a width or of its own."""
    return replace(sensor, up=UP, origin=ORIGIN, registered=False).resized(width=width)


def projected(points: ImagePoints, views: Sequence[Sensor]) -> Tensor:
    """Return the range images of points and the targets of their pixels.

    Parameters
    ----------
    points : ImagePoints
        P points of B images.
    views : sequence of Sensor
        Sensor of each image.

    Returns
    -------
    (B, 6, H, W) float32
        Range, x, y, z, intensity, and target as a number; 0 in empty pixels.
    """
    batch = points.batch
    # Points at the origin have no pixel.
    visible = batch.points.masked_fill(~batch.is_shown[:, None], 0)
    images = project(
        PointsOfScans(
            points=visible,
            intensity=batch.intensity,
            scan_of_point=points.image_of_point,
            sensors=views,
        ),
        torch.atan2,
    )
    # The last target is that of empty pixels.
    targets = torch.cat([batch.targets, batch.targets.new_zeros(1)])
    truth = targets[images.point_of_pixel].float()
    return torch.cat([images.channels, truth[:, None]], dim=1)
