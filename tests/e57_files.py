# SPDX-License-Identifier: MIT
"""E57 files for tests, written by pye57."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")


@dataclass(frozen=True)
class Station:
    """Scan of a site: points (N, 3) and intensities (N,), and the pose of the sensor."""

    points: npt.NDArray[np.float64]
    intensity: npt.NDArray[np.float32] | None = None
    yaw: float = 0.0  # Radians
    position: Sequence[float] = (0.0, 0.0, 0.0)
    invalid: npt.NDArray[np.bool_] | None = None


def write_e57(path: Path, stations: Iterable[Station]) -> Path:
    """Write scans with their poses."""
    import pye57

    path.parent.mkdir(parents=True, exist_ok=True)
    with pye57.E57(str(path), mode="w") as file:
        for station in stations:
            columns = np.ascontiguousarray(station.points.T.astype(np.float64))
            data = dict(zip(CARTESIAN, columns, strict=True))
            if station.intensity is not None:
                data["intensity"] = station.intensity
            if station.invalid is not None:
                data["cartesianInvalidState"] = 2 * station.invalid.astype(np.int8)
            half = station.yaw / 2
            rotation = np.array([np.cos(half), 0, 0, np.sin(half)])
            file.write_scan_raw(data, rotation=rotation, translation=np.array(station.position))
    return path
