# SPDX-License-Identifier: MIT
"""What labelled streets look like to the sensor, class by class, to compare simulated ones to real.

Each row of the Markdown table is a class in a data set. Ranges and shares are of points, all else
is of the range image that `predict` would make:

share, %       of the labelled points
range, m       quartiles
<5, <10, <20   share of its points that are nearer, %
top, m         quartiles of the height above the ground of the upper ends of its segments. A segment
               is a run of pixels of one class in a column; the ground is that next below it
to top, %      of the columns in which it is nearer than 15 m, those where it is so in the top rows
columns, %     of all columns, those in which it is nearer than 15 m
below          the most usual classes next below its segments, share in %
intensity      median at 0…10, 10…20 and 20…40 m, matched to that of the default weights' training

Run: python -m benchmarks.studies.street_statistics simulated=streets/ real=semantickitti/ [--json]
     [--sensor hdl64] [--limit 60] [--near 15]
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli import label_space, read_labels, read_scan, sensor
from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.geometry.intensity import intensity_quantiles, match_intensity
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import evenly_spaced, space_of

Mask = npt.NDArray[np.bool_]
GROUND = ("road", "parking", "sidewalk", "other-ground", "terrain")
NEARER_M = (5.0, 10.0, 20.0)
BINS_M = (0.0, 10.0, 20.0, 40.0)
QUARTILES = (0.25, 0.5, 0.75)
MIN_IN_TOP = 0.01
"""Share of the columns that are occupied in the top row of the view, at least."""
TOP_ROWS = 2
"""Rows that count as the top: not every column has a point in the first."""
USUAL = 3
"""Number of classes below that are named."""
TITLES = (
    *("class", "data", "share, %", "range, m", "<5/<10/<20, %"),
    *("top, m", "to top, %", "columns, %", "below, %", "intensity"),
)
NOTHING = -1
"""In the place of the class below where a segment is the lowest of its column."""


@dataclass(frozen=True, slots=True)
class ScanStatistics:
    """What one scan, or several, add to the table.

    Attributes
    ----------
    point_class, point_range : (N,)
        Of each labelled point.
    pixel_class, pixel_range, pixel_intensity : (P,)
        Of each labelled pixel.
    segment_class, segment_top, segment_below : (S,)
        Class, height of the upper end, class next below.
    near, reaching : (K,)
        Class of each column in which it is near, and of each where it so reaches the top.
    columns : (1,)
        Number of columns.
    """

    point_class: TrainIds
    point_range: Float
    pixel_class: TrainIds
    pixel_range: Float
    pixel_intensity: Float
    segment_class: TrainIds
    segment_top: Float
    segment_below: npt.NDArray[np.int16]
    near: TrainIds
    reaching: TrainIds
    columns: npt.NDArray[np.int64]


def joined(parts: Iterable[ScanStatistics]) -> ScanStatistics:
    """Return the statistics of several scans as one."""
    found = list(parts)
    columns = ([getattr(part, field.name) for part in found] for field in fields(ScanStatistics))
    return ScanStatistics(*map(np.concatenate, columns))


def segments(
    classes: TrainIds, heights: Float, occupied: Mask, ground: Mask
) -> tuple[TrainIds, Float, npt.NDArray[np.int16]]:
    """Return class, height of the upper end above the ground, and class below of each segment.

    Parameters
    ----------
    classes, heights, occupied : (H, W)
        Train ids, z and whether there is a point; empty pixels do not end a segment.
    ground : (C,) bool
        The classes that are ground. The scan's median stands in where none is below.
    """
    column, row = np.nonzero(occupied.T)
    of_pixel, z, count = classes[row, column], heights[row, column], len(row)
    first = np.ones(count, np.bool_)
    first[1:] = (of_pixel[1:] != of_pixel[:-1]) | (column[1:] != column[:-1])
    start = np.flatnonzero(first)
    following = np.append(start[1:], count)
    column_at = np.append(column, -1)
    inside = column_at[following] == column[start]
    below = np.where(inside, np.append(of_pixel, 0)[following], NOTHING).astype(np.int16)
    is_ground = ground[of_pixel]
    places = np.where(is_ground, np.arange(count), count)
    next_ground = np.minimum.accumulate(places[::-1])[::-1][start]
    known = column_at[next_ground] == column[start]
    usual = np.median(z[is_ground]) if is_ground.any() else 0.0
    foot = np.where(known, np.append(z, 0)[next_ground], usual)
    top, labelled = (z[start] - foot).astype(np.float32), of_pixel[start] > 0
    return of_pixel[start][labelled], top[labelled], below[labelled]


def near_columns(classes: TrainIds, near: Mask, occupied: Mask) -> tuple[TrainIds, TrainIds]:
    """Return the class of each column where one is near, and of each where it is so at the top.

    ``classes``, ``near`` and ``occupied`` are (H, W); no near pixel is empty.
    """
    top = int(np.argmax(occupied.mean(axis=1) >= MIN_IN_TOP))
    found = []
    for rows in (slice(None), slice(0, top + TOP_ROWS)):
        row, column = np.nonzero(near[rows] & (classes[rows] > 0))
        pairs = np.unique(np.stack([column, classes[rows][row, column]]), axis=1)
        found.append(pairs[1].astype(np.uint8))
    return found[0], found[1]


def scan_statistics(
    file: ScanFile, space: LabelSpace, own: Sensor, wanted: Sequence[float], near_m: float
) -> ScanStatistics:
    """Return the statistics of a scan with labels; intensities are matched to quantiles."""
    scan = read_scan(file.path, own)
    labels = space.to_train(read_labels(file.label_path, len(scan)), source=file.label_path)
    image = project(scan, own)
    channels = match_intensity(image.channels, own.intensity_quantiles, wanted)
    occupied = image.point_of_pixel >= 0
    classes = np.where(occupied, labels[image.point_of_pixel], 0).astype(np.uint8)
    ground = np.isin(space.names, GROUND)
    counted, pixels = (labels > 0) & (image.pixel_of_point >= 0), classes > 0
    return ScanStatistics(
        labels[counted],
        image.point_range[counted],
        classes[pixels],
        channels[0][pixels],
        channels[4][pixels],
        *segments(classes, channels[3], occupied, ground),
        *near_columns(classes, occupied & (channels[0] < near_m), occupied),
        np.array([image.width]),
    )


def class_row(found: ScanStatistics, which: int, names: Sequence[str]) -> dict[str, Any] | None:
    """Return the row of a class, None if there is none of it."""
    ranges = found.point_range[found.point_class == which]
    if not len(ranges):
        return None
    pixels, own = found.pixel_class == which, found.segment_class == which
    near = np.count_nonzero(found.near == which)
    reaching = np.count_nonzero(found.reaching == which)
    values, distances = found.pixel_intensity[pixels], found.pixel_range[pixels]
    below = found.segment_below[own]
    below = below[below != NOTHING]
    ids, counts = np.unique(below, return_counts=True)
    usual = np.argsort(-counts, kind="stable")[:USUAL]
    bins = [(distances >= low) & (distances < high) for low, high in pairwise(BINS_M)]
    return {
        "share": len(ranges) / len(found.point_range),
        "range": np.quantile(ranges, QUARTILES).tolist(),
        "nearer": [float((ranges < limit).mean()) for limit in NEARER_M],
        "top": np.quantile(found.segment_top[own], QUARTILES).tolist() if own.any() else [],
        "to_top": reaching / near if near else None,
        "columns": near / int(found.columns.sum()),
        "below": {names[ids[k]]: counts[k] / len(below) for k in usual},
        "intensity": [float(np.median(values[each])) if each.any() else None for each in bins],
    }


def data_set_rows(
    path: Path, given: Sensor, wanted: Sequence[float], *, limit: int, near_m: float
) -> dict[str, dict[str, Any] | None]:
    """Return the rows of the classes of a data set by their names; its sensor is fitted."""
    files = [file for file in find_scans(path) if file.label_path.is_file()]
    files, space = evenly_spaced(files, limit), space_of(files)
    own = fitted_view(files, given)
    quantiles = intensity_quantiles(sample_of_files(files, own).images(own))
    own = replace(own, intensity_quantiles=quantiles)
    found = joined(scan_statistics(file, space, own, wanted, near_m) for file in files)
    names = space.names
    return {names[k]: class_row(found, k, names) for k in range(1, len(names))}


def cells(row: dict[str, Any] | None) -> list[str]:
    """Return the cells of a row of the table."""
    if row is None:
        return ["0", *["–"] * 7]
    pair = (row["range"], row["top"])
    quartiles = ["/".join(f"{value:.1f}" for value in each) or "–" for each in pair]
    to_top = "–" if row["to_top"] is None else f"{100 * row['to_top']:.0f}"
    below = ", ".join(f"{name} {100 * share:.0f}" for name, share in row["below"].items())
    of_bins = ("–" if value is None else f"{value:.2f}" for value in row["intensity"])
    nearer = "/".join(f"{100 * share:.0f}" for share in row["nearer"])
    return [
        *(f"{100 * row['share']:.2f}", quartiles[0], nearer, quartiles[1], to_top),
        *(f"{100 * row['columns']:.1f}", below, "/".join(of_bins)),
    ]


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("datasets", nargs="+", metavar="NAME=PATH")
    parser.add_argument("--sensor", default="hdl64")
    parser.add_argument("--limit", type=int, default=0, help="scans of a data set; 0: all")
    parser.add_argument("--near", type=float, default=15.0, help="metres")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(words or None)
    wanted = NetworkSettings().trained_sensor().intensity_quantiles
    tables = {}
    for each in given.datasets:
        name, _, place = each.rpartition("=")
        path, own = Path(place), sensor(given.sensor)
        key = name or path.name
        tables[key] = data_set_rows(path, own, wanted, limit=given.limit, near_m=given.near)
    if given.json:
        print(json.dumps(tables))
        return
    print(f"| {' | '.join(TITLES)} |\n|{'---|' * len(TITLES)}")
    for which in label_space().names[1:]:
        for name, rows in tables.items():
            print("|", " | ".join([which, name, *cells(rows.get(which))]), "|")


if __name__ == "__main__":
    main()
