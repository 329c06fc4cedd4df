# SPDX-License-Identifier: MIT
"""Labelled points of several scans on a device, one scan after the other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredScan:
    """Labelled scan of N points in nine bytes each.

    Attributes
    ----------
    values : (N, 4) float16
        x, y, z in metres in the frame of the sensor, and intensity.
    targets : (N,) uint8
        Targets of the points.
    """

    values: Tensor
    targets: Tensor

    def __len__(self) -> int:
        return len(self.targets)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PointBatch:
    """P points of S scans.

    Attributes
    ----------
    points : (P, 3) float32
        Coordinates in metres, in the frame of the sensor.
    intensity : (P,) float32
        Intensity of each point.
    targets : (P,) uint8
        Target of each point.
    scan_of_point : (P,) int64
        Number of the scan of each point.
    is_shown : (P,) bool
        Whether a point may have a pixel. Points without a measurement, and those that an
        augmentation removes, have none.
    """

    points: Tensor
    intensity: Tensor
    targets: Tensor
    scan_of_point: Tensor
    is_shown: Tensor

    @classmethod
    def from_scans(cls, scans: Sequence[StoredScan], device: torch.device) -> Self:
        """Return the points of scans on a device, without waiting for copies from the host."""
        values = torch.cat([scan.values.to(device, non_blocking=True) for scan in scans]).float()
        targets = torch.cat([scan.targets.to(device, non_blocking=True) for scan in scans])
        counts = device_numbers([len(scan) for scan in scans], device, torch.int64)
        numbers = torch.arange(len(scans), device=device)
        points = values[:, :3]
        return cls(
            points=points,
            intensity=values[:, 3],
            targets=targets,
            # With their number, torch need not read the counts from the device.
            scan_of_point=numbers.repeat_interleave(counts, output_size=len(targets)),
            is_shown=points.isfinite().all(dim=1) & (points != 0).any(dim=1),
        )

    def per_point(self, values: Tensor) -> Tensor:
        """Return a value of each scan (S, …) for each of its points, (P, …)."""
        return values.index_select(0, self.scan_of_point)

    def part(self, points: slice) -> "PointBatch":
        """Return the points of a slice; scans have the same numbers."""
        return PointBatch(
            points=self.points[points],
            intensity=self.intensity[points],
            targets=self.targets[points],
            scan_of_point=self.scan_of_point[points],
            is_shown=self.is_shown[points],
        )


def joined(batches: Sequence[PointBatch]) -> PointBatch:
    """Return the points of batches whose scans have the same numbers."""
    return PointBatch(
        points=torch.cat([batch.points for batch in batches]),
        intensity=torch.cat([batch.intensity for batch in batches]),
        targets=torch.cat([batch.targets for batch in batches]),
        scan_of_point=torch.cat([batch.scan_of_point for batch in batches]),
        is_shown=torch.cat([batch.is_shown for batch in batches]),
    )
