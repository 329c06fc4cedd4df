# SPDX-License-Identifier: MIT
"""E57 files for tests, written by pye57."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


def write_with_limits(
    path: Path, points: npt.NDArray[np.float64], intensity: npt.NDArray[np.float32]
) -> Path:
    """Write a scan whose intensities, and their limits of 0 to 100, are integers of tenths."""
    import pye57

    lib = pye57.libe57
    with pye57.E57(str(path), mode="w") as e57:
        file = e57.image_file

        def scaled(value: float) -> Any:
            return lib.ScaledIntegerNode(file, round(10 * value), 0, 1000, 0.1, 0.0)

        columns = dict(zip(CARTESIAN, points.T.astype(np.float64), strict=True))
        prototype = lib.StructureNode(file)
        for name in columns:
            prototype.set(name, lib.FloatNode(file, 0.0, lib.E57_DOUBLE, -1e9, 1e9))
        prototype.set("intensity", scaled(0))
        limits = lib.StructureNode(file)
        limits.set("intensityMinimum", scaled(0))
        limits.set("intensityMaximum", scaled(100))
        scan = lib.StructureNode(file)
        scan.set("guid", lib.StringNode(file, "{1}"))
        scan.set("intensityLimits", limits)
        vector = lib.CompressedVectorNode(file, prototype, lib.VectorNode(file, True))
        scan.set("points", vector)
        e57.data3d.append(scan)
        buffers = lib.VectorSourceDestBuffer()
        arrays = {name: np.ascontiguousarray(c) for name, c in columns.items()}
        arrays["intensity"] = intensity.astype(np.float64)
        for name, array in arrays.items():
            buffers.append(
                lib.SourceDestBuffer(file, name, array, len(array), True, name == "intensity")
            )
        vector.writer(buffers).write(len(points))
    return path
