# SPDX-License-Identifier: MIT
"""Scans from named columns, with the names and types of several programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError
from salsanext_cli.records import Float, Scan

Columns = Mapping[str, npt.NDArray[Any]]
"""Values by name, each (N,)."""

INTENSITY_NAMES = ("intensity", "scalar_intensity", "reflectivity", "reflectance", "remission", "i")
"""Names of the intensity, in lower case; the first one found counts."""


def scan_of(columns: Columns, path: Path, intensity_scale: float) -> Scan:
    """Make a scan of the columns x, y, z and the intensity; without intensity it is 0.

    Raises
    ------
    FormatError
        If a coordinate is missing; `path` is named.
    """
    known = {name.lower(): values for name, values in columns.items() if values.dtype.kind in "iuf"}
    if missing := [axis for axis in "xyz" if axis not in known]:
        found = ", ".join(columns) or "nothing"
        raise FormatError(path, f"points of {found}", f"also {', '.join(missing)}")
    # float64 beyond float32 becomes infinity, and a NaN may signal; neither is a measurement.
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.column_stack([known[axis].astype(np.float32) for axis in "xyz"])
    values = next((known[name] for name in INTENSITY_NAMES if name in known), None)
    if values is None:
        values = np.zeros(len(points), np.float32)
    return Scan(points, normalised_intensity(values, intensity_scale))


def normalised_intensity(values: npt.NDArray[Any], scale: float) -> Float:
    """Return intensities as (N,) float32, nominally 0…1.

    Parameters
    ----------
    values : (N,), any real dtype
        Values of the file.
    scale : float
        Divides the values; a sensor's `intensity_scale`. Bytes are divided by 255 whatever the
        scale, because their type already says their range.
    """
    divisor = 255.0 if values.dtype == np.uint8 else scale
    # A signalling NaN is a point without an intensity.
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32) / np.float32(divisor)
