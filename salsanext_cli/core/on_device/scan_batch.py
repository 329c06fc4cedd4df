# SPDX-License-Identifier: MIT
"""Points of several scans on a device."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.on_device.host_points import HostPoints
from salsanext_cli.core.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointsOfScans:
    """Points of B scans on a device, in any order.

    Attributes
    ----------
    points : (P, 3) float32
        Coordinates in metres, in the frames of the files.
    intensity : (P,) float32
        Intensity of each point.
    scan_of_point : (P,) int64
        Number of the scan of each point.
    sensors : sequence of Sensor
        Sensor of each scan; their images have one size.
    """

    points: Tensor
    intensity: Tensor
    scan_of_point: Tensor
    sensors: Sequence[Sensor]

    def per_point(self, values: Tensor) -> Tensor:
        """Return a value of each scan (B, …) for each of its points, (P, …)."""
        return values[self.scan_of_point]

    def tensor(self, values: npt.ArrayLike, dtype: torch.dtype = torch.float32) -> Tensor:
        """Return numbers as a tensor on the device of the points, without waiting for it."""
        return device_numbers(values, self.points.device, dtype)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanBatch(PointsOfScans):
    """Points of B scans on a device, one scan after the other, copied there once.

    Attributes
    ----------
    counts : list of int
        Number of points of each scan, with sum P.
    """

    counts: list[int]

    @classmethod
    def on_device(
        cls, scans: Sequence[HostPoints], sensors: Sequence[Sensor], device: str
    ) -> "ScanBatch":
        """Copy the points of scans to a device, without waiting for it."""
        points = [scan.points.to(device, non_blocking=True) for scan in scans]
        intensity = [scan.intensity.to(device, non_blocking=True) for scan in scans]
        counts = [len(scan.points) for scan in scans]
        numbers = [
            torch.full((count,), number, device=device) for number, count in enumerate(counts)
        ]
        return cls(
            points=torch.cat(points),
            intensity=torch.cat(intensity),
            scan_of_point=torch.cat(numbers),
            counts=counts,
            sensors=sensors,
        )

    def sum_per_scan(self, values: Tensor) -> Tensor:
        """Return the sums (B,) int64 of integers or flags (P,) of the points of each scan.

        A running sum, because additions of all points to few numbers would wait for each other.
        """
        bounds = device_numbers([0, *accumulate(self.counts)], values.device, torch.int64)
        totals = F.pad(values.cumsum(dim=0), (1, 0))
        return totals[bounds].diff()
