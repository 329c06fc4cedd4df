# SPDX-License-Identifier: MIT
"""Range images of the scans of a batch, equal to those of `geometry.projection`.

All operations are those of the kernels, in their order and number types. Divisors are tensors on
the device, because torch multiplies by the rounded inverse of a number of the host.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.core.geometry.projection import PI, TAN_22_5
from salsanext_cli.core.on_device.frames import sensor_points
from salsanext_cli.core.on_device.scan_batch import PointsOfScans, ScanBatch
from salsanext_cli.core.records import CHANNELS, MAX_INTENSITY, MAX_RANGE_M

TERMS_OF_ARCTAN = 13  # Of the series t − t³/3 + t⁵/5 − …
INDEX_BITS = 32  # Of a candidate: the index of its point, below the bits of its range
SPARE_PLACES = 1 << 12  # Places for points without a pixel, of which each delays those of its place
NO_CANDIDATE = torch.iinfo(torch.int64).max


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeImages:
    """Range images of B scans with P points in all.

    Attributes
    ----------
    channels : (B, 5, H, W) float32
        Range, x, y, z in metres and intensity of the nearest point per pixel; 0 where empty.
    pixel_of_point : (P,) int64
        Flat index of the pixel of every point among all B · H · W pixels, -1 for none.
    point_range : (P,) float32
        Distance of every point from its sensor in metres; 0 for points without a pixel.
    point_of_pixel : (B, H, W) int64
        Index of the nearest point of every pixel, P where empty.
    is_ego : (P,) bool, optional
        Whether a point is on its sensor or vehicle; None if no sensor knows such points.
    """

    channels: Tensor
    pixel_of_point: Tensor
    point_range: Tensor
    point_of_pixel: Tensor
    is_ego: Tensor | None

    @property
    def occupied(self) -> Tensor:
        """Pixels with a point, (B, H, W) bool."""
        return self.channels[:, 0] > 0


def project(
    batch: PointsOfScans, angle_of: Callable[[Tensor, Tensor], Tensor] | None = None
) -> RangeImages:
    """Project the scans of a batch onto the range images of their sensors (paper eq. 1).

    Parameters
    ----------
    batch : PointsOfScans
        B scans with P points in all.
    angle_of : callable, optional
        Function of y and x, float64, to their angle in radians; by default `arctan2`, with the bits
        of the kernel. ``torch.atan2`` is one kernel of a GPU instead of sixty.

    Returns
    -------
    RangeImages
        Pixels of the points, and their channels.
    """
    in_frame = sensor_points(batch)
    points = in_frame.points
    pixel_of_point, point_range = _pixels(batch, points, angle_of or arctan2)
    size = (len(batch.sensors), batch.sensors[0].height, batch.sensors[0].width)
    nearest = _nearest_points(pixel_of_point, point_range, math.prod(size))
    is_usable = batch.intensity.abs() <= float(MAX_INTENSITY)
    intensity = batch.intensity.where(is_usable, 0)
    values = torch.cat([point_range[:, None], points, intensity[:, None]], dim=1)
    # The last row is that of empty pixels.
    values = torch.cat([values, values.new_zeros(1, len(CHANNELS))])
    return RangeImages(
        channels=values[nearest].view(*size, len(CHANNELS)).permute(0, 3, 1, 2),
        pixel_of_point=pixel_of_point,
        point_range=point_range,
        point_of_pixel=nearest.view(size),
        is_ego=in_frame.is_ego,
    )


def _pixels(
    batch: PointsOfScans, points: Tensor, angle_of: Callable[[Tensor, Tensor], Tensor]
) -> tuple[Tensor, Tensor]:
    """Return the pixels and the ranges of points.

    Parameters
    ----------
    batch : PointsOfScans
        Batch of the points.
    points : (P, 3) float32
        Coordinates in the frames of the sensors, in metres.
    angle_of : callable
        As in `project`.

    Returns
    -------
    pixel_of_point : (P,) int64
        As in `RangeImages`.
    point_range : (P,) float32
        As in `RangeImages`.
    """
    height = batch.sensors[0].height
    width = batch.sensors[0].width
    down = [math.radians(sensor.fov_down) for sensor in batch.sensors]
    extent = [
        math.radians(sensor.fov_up) - lower
        for sensor, lower in zip(batch.sensors, down, strict=True)
    ]
    drops = [sensor.out_of_view == "drop" for sensor in batch.sensors]
    a, b, c = points.double().unbind(dim=1)
    distance = (a * a + b * b + c * c).sqrt().float()
    slope = (points[:, 2] / distance).double()
    level = ((1 - slope) * (1 + slope)).sqrt()
    yaw, pitch = angle_of(torch.stack([b, slope]), torch.stack([a, level])).float()
    u = 0.5 * (1 - yaw / torch.full((), float(PI), device=yaw.device)) * width
    # One copy to a GPU instead of two, and most often none of what is dropped.
    lowest, height_of_view = batch.tensor([down, extent])
    elevation = pitch - batch.per_point(lowest)
    v = (1 - elevation / batch.per_point(height_of_view)) * height
    is_seen = (distance > 0) & (distance <= float(MAX_RANGE_M))
    if any(drops):
        is_in_view = (v >= 0) & (v <= height)
        is_seen &= is_in_view | ~batch.per_point(batch.tensor(drops, torch.bool))
    pixel = _clamped(v, height) * width + _clamped(u, width)
    pixel += batch.scan_of_point * (height * width)
    return pixel.where(is_seen, -1), distance.where(is_seen, 0)


def _clamped(places: Tensor, size: int) -> Tensor:
    """Return places (P,) float32 as indices 0 … size − 1, int64; NaN is 0."""
    inside = places.where(places > 0, 0)
    return inside.where(inside < size, size - 1).long()


def arctan2(y: Tensor, x: Tensor) -> Tensor:
    """Return atan2(y, x) of float64 within 1e-11, with the bits of the kernel."""
    is_steep = y.abs() > x.abs()
    small = torch.where(is_steep, x, y).abs()
    large = torch.where(is_steep, y, x).abs()
    is_turned = small > TAN_22_5 * large
    numerator = torch.where(is_turned, small - large, small)
    denominator = torch.where(is_turned, small + large, large)
    t = numerator / denominator.where(denominator > 0, 1.0)
    q = t * t
    series = torch.full_like(q, 1 / (2 * TERMS_OF_ARCTAN - 1))
    for term in reversed(range(TERMS_OF_ARCTAN - 1)):
        series = q * series + (-1) ** term / (2 * term + 1)
    angle = t * series
    angle = torch.where(is_turned, angle + math.pi / 4, angle)
    angle = torch.where(is_steep, math.pi / 2 - angle, angle)
    angle = torch.where(x.signbit(), math.pi - angle, angle)
    return angle.copysign(y)


def _nearest_points(pixel_of_point: Tensor, point_range: Tensor, pixels: int) -> Tensor:
    """Return the nearest point of each pixel, the first in a tie; P for none.

    A candidate is one integer: the bits of its range, which are in the order of ranges ≥ 0, and
    below them its index.

    Parameters
    ----------
    pixel_of_point : (P,) int64
        Pixel of each point, -1 for none.
    point_range : (P,) float32
        Range of each point in metres.
    pixels : int
        Number of pixels.

    Returns
    -------
    (pixels,) int64
    """
    count = len(pixel_of_point)
    index = torch.arange(count, device=pixel_of_point.device)
    candidate = (point_range.view(torch.int32).long() << INDEX_BITS) | index
    spare = pixels + index % SPARE_PLACES
    target = pixel_of_point.where(pixel_of_point >= 0, spare)
    nearest = torch.full((pixels + SPARE_PLACES,), NO_CANDIDATE, device=index.device)
    nearest.scatter_reduce_(0, target, candidate, "amin")
    nearest = nearest[:pixels]
    point = nearest & ((1 << INDEX_BITS) - 1)
    return point.where(nearest != NO_CANDIDATE, count)


def points_from_pixels(values: Tensor, images: RangeImages, empty: float) -> Tensor:
    """Return the values (B, K, H, W) of the pixels of points, (P, K); `empty` without a pixel."""
    rows = values.permute(0, 2, 3, 1).reshape(-1, values.shape[1])
    has_pixel = images.pixel_of_point >= 0
    return rows[images.pixel_of_point.clamp(min=0)].where(has_pixel[:, None], empty)


def ego_counts(batch: ScanBatch, images: RangeImages) -> Tensor:
    """Return the number of points of each scan on its sensor or vehicle, (B,) int64."""
    if images.is_ego is None:
        return torch.zeros(len(batch.counts), dtype=torch.int64, device=batch.points.device)
    return batch.sum_per_scan(images.is_ego)
