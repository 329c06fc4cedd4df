# SPDX-License-Identifier: MIT
"""Scans of a batch in the frames of their sensors, as `geometry.sensor_frame` turns one."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.geometry.sensor_frame import upright_rotation
from salsanext_cli.core.on_device.scan_batch import PointsOfScans
from salsanext_cli.core.sensors.sensor import ORIGIN, UP

NO_BOX = ((np.inf,) * 3, (-np.inf,) * 3)  # No point lies in it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorPoints:
    """Points of a batch in the frames of their sensors.

    Attributes
    ----------
    points : (P, 3) float32
        Coordinates in metres; 0 for points of the vehicle.
    is_ego : (P,) bool, optional
        Whether a point is on its sensor or vehicle; None if no sensor knows such points.
    """

    points: Tensor
    is_ego: Tensor | None


def sensor_points(batch: PointsOfScans) -> SensorPoints:
    """Return the points of a batch in the frames of their sensors, those of vehicles at 0."""
    points = _upright(batch, _moved(batch))
    is_ego = _ego(batch, points)
    if is_ego is not None:
        points = points.masked_fill(is_ego[:, None], 0)
    return SensorPoints(points=points, is_ego=is_ego)


def _moved(batch: PointsOfScans) -> Tensor:
    """Return the points (P, 3) around their sensors; points at 0 are no measurements and stay."""
    points = batch.points
    origins = [sensor.origin for sensor in batch.sensors]
    if all(origin == ORIGIN for origin in origins):
        return points
    is_zero = (points == 0).all(dim=1, keepdim=True)
    return (points - batch.per_point(batch.tensor(origins))).masked_fill(is_zero, 0)


def _upright(batch: PointsOfScans, points: Tensor) -> Tensor:
    """Return points (P, 3) with the `up` of their sensors along z."""
    tilted = [sensor.up != UP for sensor in batch.sensors]
    if not any(tilted):
        return points
    rotations = np.stack([upright_rotation(np.asarray(sensor.up)) for sensor in batch.sensors])
    rotation = batch.per_point(batch.tensor(rotations, torch.float64))
    x, y, z = points.double()[:, None].unbind(dim=2)
    turned = rotation[..., 0] * x + rotation[..., 1] * y + rotation[..., 2] * z
    is_tilted = batch.per_point(batch.tensor(tilted, torch.bool))
    return torch.where(is_tilted[:, None], turned.float(), points)


def _ego(batch: PointsOfScans, points: Tensor) -> Tensor | None:
    """Return which points (P, 3) lie on a sensor or its vehicle, (P,) bool; None without any."""
    nearest = [sensor.min_range or 0.0 for sensor in batch.sensors]
    boxes = [np.array(sensor.ego_box or NO_BOX).reshape(2, 3) for sensor in batch.sensors]
    if not any(nearest) and not any(sensor.ego_box for sensor in batch.sensors):
        return None
    x, y, z = points.unbind(dim=1)
    squares = x * x + y * y + z * z
    is_near = squares < batch.per_point(batch.tensor(nearest).square())
    low, high = batch.tensor(np.stack(boxes, axis=1), torch.float64)
    exact = points.double()
    in_box = ((exact >= batch.per_point(low)) & (exact <= batch.per_point(high))).all(dim=1)
    return (squares > 0) & (is_near | in_box)
