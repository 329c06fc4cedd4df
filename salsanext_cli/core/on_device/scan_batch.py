# SPDX-License-Identifier: MIT
"""Points of several scans on a device, copied there once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.compiled import argument
from salsanext_cli.core.records import Scan
from salsanext_cli.core.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HostPoints:
    """Points of a scan in memory that a GPU reads directly.

    Attributes
    ----------
    points : (N, 3) float32
        Coordinates in metres, in the frame of their file.
    intensity : (N,) float32
        Intensity of each point.
    """

    points: Tensor
    intensity: Tensor

    @classmethod
    def from_scan(cls, scan: Scan, device: str) -> "HostPoints":
        """Return the points of a scan for a device; a GPU gets a copy in pinned memory."""
        points = torch.from_numpy(argument(scan.points, np.float32))
        intensity = torch.from_numpy(argument(scan.intensity, np.float32))
        if device != "cpu":
            points = points.pin_memory()
            intensity = intensity.pin_memory()
        return cls(points=points, intensity=intensity)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanBatch:
    """Points of B scans on a device; those that `on_device` copies lie one scan after the other.

    Attributes
    ----------
    points : (P, 3) float32
        Coordinates in metres, in the frames of the files.
    intensity : (P,) float32
        Intensity of each point.
    scan_of_point : (P,) int64
        Number of the scan of each point.
    counts : list of int
        Number of points of each scan, with sum P.
    sensors : sequence of Sensor
        Sensor of each scan; their images have one size.
    """

    points: Tensor
    intensity: Tensor
    scan_of_point: Tensor
    counts: list[int]
    sensors: Sequence[Sensor]

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

    def per_point(self, values: Tensor) -> Tensor:
        """Return a value of each scan (B, …) for each of its points, (P, …)."""
        return values[self.scan_of_point]

    def tensor(self, values: object, dtype: torch.dtype = torch.float32) -> Tensor:
        """Return numbers as a tensor on the device of the points."""
        return torch.tensor(values, dtype=dtype, device=self.points.device)
