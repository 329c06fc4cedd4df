# SPDX-License-Identifier: MIT
"""LAS and LAZ files for tests, written by laspy."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
SCALE_M = 0.001
PROJECTION = "LASF_Projection"


def write_las(
    path: Path,
    points: Array,
    intensity: Array | None = None,
    *,
    kind: int = 6,
    offsets: Iterable[float] = (0.0, 0.0, 0.0),
    scale: float = SCALE_M,
    records: Iterable[Any] = (),
    extended_records: Iterable[Any] = (),
    extra: dict[str, Array] | None = None,
    **fields: Array,
) -> Path:
    """Write points (N, 3), intensities (N,), further dimensions, and records.

    Extended records lie behind the points.
    """
    import laspy

    header = laspy.LasHeader(point_format=kind)
    header.scales = [scale] * 3
    header.offsets = np.array([*offsets])
    header.add_extra_dims([laspy.ExtraBytesParams(n, v.dtype) for n, v in (extra or {}).items()])
    header.vlrs.extend(records)
    if extended_records:
        header.evlrs = laspy.vlrs.vlrlist.VLRList(extended_records)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.asarray(points, np.float64).T
    if intensity is not None:
        cloud.intensity = intensity
    for name, values in {**fields, **(extra or {})}.items():
        cloud[name] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    cloud.write(path)
    return path


def keys_record(*pairs: tuple[int, int]) -> Any:
    """Return a record of GeoTIFF keys and their values."""
    import laspy

    rows = [(1, 1, 0, len(pairs)), *((key, 0, 1, value) for key, value in pairs)]
    return laspy.VLR(PROJECTION, 34735, "", np.array(rows, "<u2").tobytes())


def size_records(metres: float) -> list[Any]:
    """Return records of GeoTIFF keys of a unit of length without a code, by its metres."""
    import laspy

    rows = [(1, 1, 0, 2), (3076, 0, 1, 32767), (3077, 34736, 1, 1)]
    keys = laspy.VLR(PROJECTION, 34735, "", np.array(rows, "<u2").tobytes())
    numbers = laspy.VLR(PROJECTION, 34736, "", np.array([7.0, metres], "<f8").tobytes())
    return [keys, numbers]


def text_record(text: str) -> Any:
    """Return a record of a coordinate system as text."""
    import laspy

    return laspy.VLR(PROJECTION, 2112, "", text.encode())
