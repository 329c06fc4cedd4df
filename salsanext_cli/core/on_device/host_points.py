# SPDX-License-Identifier: MIT
"""Points of a scan in memory that a GPU reads directly."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from salsanext_cli.core.compiled import argument
from salsanext_cli.core.engines.device_copies import pinned_array
from salsanext_cli.core.records import Scan


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
        return cls(
            points=pinned_array(argument(scan.points, np.float32), device),
            intensity=pinned_array(argument(scan.intensity, np.float32), device),
        )
