# SPDX-License-Identifier: MIT
"""Point clouds of a page: 16 bits per axis and one byte per value, as base64."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.report.colours import FIXED_SCALES, value_range
from salsanext_cli.report.page.run_results import ShownScan
from salsanext_cli.report.scan_pictures import UNITS
from salsanext_cli.runs.results.scan_results import ScanResults

MAX_POINTS = 200_000  # Most points of a scan in a page; larger scans are thinned evenly
FARTHEST_M = 1e4  # Farther points are skipped: they would make 16 bits too coarse
STEPS = 65535
NO_VALUE = 255  # Byte of a point without a value; values are 0 to 254
Scale = Mapping[str, Any]  # `marks` at equal steps of the 255 values, and their `unit`


def scales_of(scans: Sequence[ShownScan]) -> dict[str, Scale]:
    """Return the scale of every value: fixed, or from 0 to the 99th percentile."""
    values: dict[str, list[npt.NDArray[Any]]] = {}
    for scan in scans:
        for name, point_values in scan.values().items():
            values.setdefault(name, []).append(point_values)
    scales: dict[str, Scale] = {}
    for name, arrays in values.items():
        highest = value_range(np.concatenate(arrays))[1]
        linear = (0.0, highest if highest > 0 and name != "least_confidence" else 1.0)
        marks = FIXED_SCALES.get(name, linear)
        scales[name] = {"marks": marks, "unit": UNITS.get(name, "")}
    return scales


def encode_cloud(
    shown: ShownScan, space: LabelSpace, sensor: Sensor, scales: Mapping[str, Scale]
) -> dict[str, object]:
    """Return a scan as plain data, arrays as base64 of little-endian integers.

    Points are sorted by pixel of the range image, then by range; points without a pixel come last.
    So the number of points of every pixel assigns points to pixels.
    """
    points = shown.results.scan.points
    measured = np.flatnonzero((np.abs(points) <= FARTHEST_M).all(axis=1))
    step = -(-len(measured) // MAX_POINTS)
    taken = measured[:: max(step, 1)]
    image = project(shown.results.scan.take(taken), shown.results.sensor or sensor)
    pixel = image.pixel_of_point
    pixel = np.where(pixel < 0, image.point_of_pixel.size, pixel)
    nearest = np.zeros(len(taken), bool)
    nearest[image.point_of_pixel[image.point_of_pixel >= 0]] = True
    order = np.lexsort((image.point_range, ~nearest, pixel))
    points_of_pixel = np.bincount(pixel, minlength=image.point_of_pixel.size + 1)[:-1]
    width = np.min_scalar_type(points_of_pixel.max(initial=0)).itemsize
    index = taken[order]
    position, low, step_m = _positions(points[index])
    values = _classes(shown.results, space, index) | {
        name: _bytes_on_scale(point_values[index], scales[name])
        for name, point_values in shown.values().items()
    }
    return {
        "name": shown.name,
        "reason": shown.reason,
        "points": len(points),
        "shown": len(index),
        "height": image.height,
        "width": image.width,
        "low": low,
        "step": step_m,
        "position": base64_of(position, "<u2"),
        "of_pixel": base64_of(points_of_pixel, f"<u{width}"),
        "of_pixel_bytes": width,
        "boxes": shown.boxes,
        "values": {name: base64_of(array, "u1") for name, array in values.items()},
    }


def base64_of(values: npt.NDArray[Any], dtype: str) -> str:
    """Return an array as base64 of its bytes in a dtype."""
    return b64encode(np.ascontiguousarray(values, np.dtype(dtype)).tobytes()).decode("ascii")


def _positions(points: Float) -> tuple[npt.NDArray[np.uint16], list[float], list[float]]:
    """Return positions in steps above the lowest corner, (N, 3), that corner, and the steps."""
    if not len(points):
        return np.empty((0, 3), np.uint16), [0.0] * 3, [1.0] * 3
    low = points.min(axis=0).astype(np.float64)
    span = points.max(axis=0) - low
    step = np.where(span > 0, span, 1.0) / STEPS
    return np.rint((points - low) / step).astype(np.uint16), low.tolist(), step.tolist()


def _bytes_on_scale(values: npt.NDArray[Any], scale: Scale) -> npt.NDArray[np.uint8]:
    """Return values as 0 to 254 on a scale, clipped to its ends."""
    marks = scale["marks"]
    share = np.interp(values, marks, np.linspace(0, 1, len(marks)))
    steps = np.rint(np.nan_to_num(share) * (NO_VALUE - 1))
    return np.where(np.isnan(values), NO_VALUE, steps).astype(np.uint8)


def _classes(
    results: ScanResults, space: LabelSpace, index: npt.NDArray[np.intp]
) -> dict[str, npt.NDArray[np.uint8]]:
    """Return train ids of label and truth, and the outcome: 0 not judged, 1 right, 2 wrong."""
    classes: dict[str, npt.NDArray[np.uint8]] = {}
    if results.label is not None:
        classes["label"] = space.to_train(results.label[index], strict=False)
    if results.truth is not None:
        classes["truth"] = space.to_train(results.truth[index], strict=False)
        if results.label is not None:
            classes["wrong"] = np.nan_to_num(results.wrong(space)[index] + 1).astype(np.uint8)
    return classes
