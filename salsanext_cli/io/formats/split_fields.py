# SPDX-License-Identifier: MIT
"""Fields of a file that tell several scans or sensors in one cloud apart."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import FieldSplit
from salsanext_cli.io.formats.field_names import FieldName

SENSORS = ("lidar", "sensor", "device", "source")
"""Names of fields with the number of a sensor, also with one of `NUMBERS` behind; `laser` and
`ring` number beams."""
SCANS = ("scan", "frame", "sweep")  # Names of fields with the number of a scan
NUMBERS = ("", "_id", "_index", "_idx", "_number", "id", "index")
TIMES = ("time", "timestamp", "time_stamp", "t", "ts", "time_lag", "gps_time", "stamp")
"""Names of fields with a time; the unit varies."""
MAX_SENSORS = 16  # Most different values that number sensors
MAX_SCANS = 256  # Most different values that number scans
MAX_VALUES = 4096  # Values in a sample of a field


def split_field(columns: Mapping[str, npt.NDArray[Any]]) -> FieldSplit | None:
    """Return the field that divides the points of columns, (N,) each by name; None without one."""
    return next(_splits(columns), None)


def _splits(columns: Mapping[str, npt.NDArray[Any]]) -> Iterator[FieldSplit]:
    yield from _numbered_splits(columns, "sensor", SENSORS, MAX_SENSORS)
    yield from _numbered_splits(columns, "scan", SCANS, MAX_SCANS)
    for field, values in columns.items():
        count = _count(values) if FieldName.parsed(field).plain in TIMES else 0
        if count > 1:
            # A scan has one time, or each of its points has another.
            yield FieldSplit(
                field=field, kind="scan" if count <= MAX_SCANS else "time", count=count
            )


def _numbered_splits(
    columns: Mapping[str, npt.NDArray[Any]], kind: str, names: Sequence[str], most: int
) -> Iterator[FieldSplit]:
    """Yield the fields of some names, with a number of sensor or scan, that divide the points."""
    numbered = {name + number for name in names for number in NUMBERS}
    for field, values in columns.items():
        count = _count(values) if FieldName.parsed(field).plain in numbered else 0
        if 1 < count <= most:
            yield FieldSplit(field=field, kind=kind, count=count)


def _count(values: npt.NDArray[Any]) -> int:
    """Return the number of different finite values (N,) in a sample."""
    sample = values[:: max(len(values) // MAX_VALUES, 1)]
    return len(np.unique(sample[np.isfinite(sample)]))
