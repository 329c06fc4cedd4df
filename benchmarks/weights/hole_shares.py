# SPDX-License-Identifier: MIT
"""Share of holes in the range images of sensors: `HOLE_SHARES` of `training.data.other_sensors`.

A hole is an empty pixel with measured ones to its left and right, few pixels apart. Each scan is
seen as the default weights see it, in 64 x 512 pixels of the view that is fitted to its sensor; no
labels are read. Lines are sensors and their mean, from which a sensor is left out where it has too
few pixels (nan). Columns, in %, are those on surfaces, and then those at edges: all holes, holes by
range, and the share of holes whose neighbour to the right is a hole, too.

Run: python -m benchmarks.weights.hole_shares pandar64=pandaset/sequences/001 vlp32c=aachen/
     os0=ouster/os0_128.bin os1=ouster/os1_128.bin os2=ouster/os2_32.bin
     [--sensor hdl64-512] [--limit 60]
"""

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli import project, read_scan, sensor
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.other_sensors import HOLE_SHARES, hole_cells

KINDS, BINS = HOLE_SHARES.shape
TITLES = ("all", *(f"bin {k + 1}" for k in range(BINS)), "go on")
MIN_PIXELS = 100
"""Pixels of a cell below which its share is not shown."""

Counts = npt.NDArray[np.int64]


def count_holes(ranges: Float) -> Counts:
    """Return pixels, holes, and holes that go on to the right, of each cell, (3, KINDS, BINS)."""
    cells, hole = hole_cells(ranges), ranges <= 0
    inside = cells >= 0
    going_on = hole & np.roll(hole & inside, -1, axis=1)
    counted = (cells[inside & which] for which in (np.True_, hole, going_on))
    counts = [np.bincount(each, minlength=KINDS * BINS) for each in counted]
    return np.reshape(counts, (3, KINDS, BINS))


def shares(path: Path, given: Sensor, limit: int) -> npt.NDArray[np.float64]:
    """Return the columns of a sensor's scans, (KINDS, BINS + 2)."""
    files = evenly_spaced(find_scans(path), limit)
    own = fitted_view(files, given)
    images = (project(read_scan(file.path, own), own) for file in files)
    counts = np.sum([count_holes(image.channels[0]) for image in images], axis=0)
    pixels, holes, going_on = counts
    total = holes.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        by_range = np.where(pixels < MIN_PIXELS, np.nan, holes / pixels)
        columns = (total / pixels.sum(axis=1), *by_range.T, going_on.sum(axis=1) / total)
    return np.stack(columns, axis=1)


def line(name: str, columns: npt.NDArray[np.float64]) -> str:
    """Return a line of the table."""
    return "  ".join([f"{name:12}", *(f"{100 * value:5.1f}" for value in columns.ravel())])


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("sensors", nargs="+", metavar="NAME=PATH")
    parser.add_argument("--sensor", default="hdl64-512")
    parser.add_argument("--limit", type=int, default=60, help="scans of each; 0: all")
    given = parser.parse_args(words or None)
    print("  ".join([f"{'':12}", *(f"{title:>5}" for title in TITLES * KINDS)]))
    found = []
    for each in given.sensors:
        name, _, place = each.rpartition("=")
        path = Path(place)
        found.append(shares(path, sensor(given.sensor), given.limit))
        print(line(name or path.stem, found[-1]), flush=True)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(found).sum(axis=0)
        print(line("mean", np.nansum(found, axis=0) / known))


if __name__ == "__main__":
    main()
