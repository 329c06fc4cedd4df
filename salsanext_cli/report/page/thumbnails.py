# SPDX-License-Identifier: MIT
"""Small pictures of scans from above, in the colours of their labels."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Collection
from io import BytesIO

import numpy as np

from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.records import Double, Float
from salsanext_cli.report.colours import Colours, value_colours, value_range
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.report.page.scan_row import ScanRow
from salsanext_cli.report.scan_pictures import raster
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.comparison import ScanComparison

MAX_THUMBNAILS = 100  # Most thumbnails of a page, each of about 5 kB
MAX_POINTS = 20_000  # About so many points are drawn, evenly spaced
SIZE_PX = 96
SHARE_INSIDE = 0.85  # Share of the points within the picture
LEAST_REACH_M = 4.0
PNG = "data:image/png;base64,"


def scans_for_thumbnails(run: RunResults, names: Collection[str]) -> list[ScanFile]:
    """Return the scans with some names and the most uncertain ones, at most `MAX_THUMBNAILS`."""
    kind = run.leading_kind or ""

    def rank(row: ScanRow) -> tuple[bool, float]:
        mean = row.uncertainty.get(kind, math.nan)
        return row.file.name not in names, -mean if math.isfinite(mean) else math.inf

    return [row.file for row in sorted(run.rows, key=rank)[:MAX_THUMBNAILS]]


def thumbnail(file: ScanFile, reader: ScanComparison, colours: Colours) -> tuple[str, str]:
    """Draw a scan from above.

    Parameters
    ----------
    file : ScanFile
        Scan with results.
    reader : ScanComparison
        Folder of the results, and their classes.
    colours : ndarray of uint8 (C, 3)
        Red, green and blue of each class.

    Returns
    -------
    tuple of str
        Name of the scan, and its picture, a PNG as an address for `img`.
    """
    results = ResultFolder(reader.out).read(file, reader.sensor, reader.space)
    points = in_sensor_frame(results.scan, results.sensor or reader.sensor).points
    drawn = np.arange(0, len(points), max(len(points) // MAX_POINTS, 1))
    if results.label is not None:
        labels = reader.space.to_train(results.label[drawn], strict=False)
        point_colours = colours[labels]
    else:
        values = next(iter(results.uncertainty.values()), results.range)[drawn]
        point_colours = value_colours(values, *value_range(values))
    png = _picture(points[drawn], point_colours)
    return file.name, PNG + b64encode(png).decode("ascii")


def _picture(points: Float, colours: Colours) -> bytes:
    """Draw points (N, 3), metres, from above around their middle, as a PNG."""
    from matplotlib.image import imsave

    middle, reach = _frame(points)
    shifted = points - np.append(middle, 0.0).astype(np.float32)
    pixels = raster(shifted, colours, reach, SIZE_PX)
    png = BytesIO()
    imsave(png, pixels, format="png")
    return png.getvalue()


def _frame(points: Float) -> tuple[Double, float]:
    """Return the middle (2,) of the points from above, and the distance to an edge, metres."""
    measured = points[np.isfinite(points).all(axis=1) & points.any(axis=1), :2].astype(np.float64)
    if not len(measured):
        return np.zeros(2), LEAST_REACH_M
    middle = np.median(measured, axis=0)
    far = np.abs(measured - middle).max(axis=1)
    return middle, max(float(np.quantile(far, SHARE_INSIDE)), LEAST_REACH_M)
