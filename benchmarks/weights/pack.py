# SPDX-License-Identifier: MIT
"""Labelled scans of several data sets in one small file, for a machine that nothing else reaches.

Coordinates are stored in 1/128 m as int16, intensity (0…1) in 1/255 as uint8, labels as uint8.
Points beyond 255 m are dropped. `unpack` writes the data sets again, in SemanticKITTI's layout.

Run: python -m benchmarks.weights.pack pandaset/ pandargt/ aachen/ pack.npz
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError, LabelError, NoInputError, UsageError
from salsanext_cli.core.records import Scan
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.kitti_labels import encode_labels, read_labels
from salsanext_cli.runs.scans.scan_search import find_scans

STEPS_PER_M = 128
MAX_COORDINATE_M = 255.0
MAX_INTENSITY, MAX_LABEL = 255, 255
MAX_BYTES = 40 << 20
KEYS = ("points", "intensity", "labels", "names", "counts")

Arrays = dict[str, npt.NDArray[Any]]


def pack(datasets: Sequence[Path], target: Path) -> int:
    """Write the labelled scans of data sets, by the names of their folders; return the bytes."""
    names = [dataset.resolve().name for dataset in datasets]
    if len({*names}) < len(names):
        raise UsageError("data sets", ", ".join(names), "folders of different names")
    arrays: Arrays = {}
    for name, dataset in zip(names, datasets, strict=True):
        arrays |= {f"{name}/{key}": array for key, array in packed(dataset).items()}
    with target.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    size = target.stat().st_size
    if size > MAX_BYTES:
        raise UsageError(target, f"{size / 2**20:.1f} MiB", f"at most {MAX_BYTES >> 20} MiB")
    return size


def packed(dataset: Path) -> Arrays:
    """Return the arrays of a data set: scans one after the other, their names and lengths.

    ``points`` (2, 3, N) uint8 are the high and low bytes of each coordinate, apart because they
    compress better; ``intensity`` and ``labels`` are (N,) uint8.
    """
    scans, labels, names = [], [], []
    for file in find_scans(dataset):
        if not file.label_path.is_file():
            continue
        scan = read_scan(file.path)
        raw = read_labels(file.label_path, len(scan))
        if raw.max(initial=0) > MAX_LABEL:
            raise LabelError(file.label_path, f"label {raw.max()}", f"labels up to {MAX_LABEL}")
        if not 0 <= scan.intensity.min(initial=0) <= scan.intensity.max(initial=0) <= 1:
            raise FormatError(
                file.path, f"intensity {scan.intensity.max()}", "intensity from 0 to 1"
            )
        near = np.flatnonzero(np.abs(scan.points).max(axis=1, initial=0) <= MAX_COORDINATE_M)
        if len(near) < len(scan):
            print(f"{file.path}: dropped {len(scan) - len(near)} points: too far or not finite")
        scans.append(scan.take(near))
        labels.append(raw[near].astype(np.uint8))
        names.append(f"{file.sequence}/{file.stem}")
    if not scans:
        raise NoInputError(dataset, "no labelled scans", "scans with label files")
    points = np.concatenate([np.rint(scan.points * STEPS_PER_M) for scan in scans])
    bits = points.astype(np.int16).T.astype(np.uint16)
    intensity = np.concatenate([scan.intensity for scan in scans])
    return {
        "points": np.stack([bits >> 8, bits & 255]).astype(np.uint8),
        "intensity": np.rint(intensity * MAX_INTENSITY).astype(np.uint8),
        "labels": np.concatenate(labels),
        "names": np.array(names),
        "counts": np.array([len(scan) for scan in scans]),
    }


def unpack(file: Path, folder: Path) -> list[Path]:
    """Write the data sets of a packed file below a folder, and return theirs."""
    roots = []
    with np.load(file, allow_pickle=False) as content:
        for name in dict.fromkeys(key.partition("/")[0] for key in content.files):
            of_dataset = {key: content[f"{name}/{key}"] for key in KEYS}
            unpack_dataset(of_dataset, folder / name)
            roots.append(folder / name)
    return roots


def unpack_dataset(arrays: Mapping[str, npt.NDArray[Any]], root: Path) -> None:
    """Write the scans and labels of a data set."""
    high, low = arrays["points"].astype(np.uint16)
    points = (high << 8 | low).view(np.int16).T.astype(np.float32) / np.float32(STEPS_PER_M)
    intensity = arrays["intensity"].astype(np.float32) / np.float32(MAX_INTENSITY)
    ends = np.cumsum(arrays["counts"])
    for name, end, count in zip(arrays["names"], ends, arrays["counts"], strict=True):
        part, (sequence, stem) = slice(end - count, end), str(name).split("/")
        place = root / "sequences" / sequence
        scan = Scan(points[part], intensity[part])
        write_bytes(place / "velodyne" / f"{stem}.bin", encode_bin(scan))
        labels = encode_labels(arrays["labels"][part].astype(np.uint32))
        write_bytes(place / "labels" / f"{stem}.label", labels)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("datasets", type=Path, nargs="+", help="SemanticKITTI's layout")
    parser.add_argument("target", type=Path, help="packed file (.npz)")
    given = parser.parse_args(words or None)
    print(f"{given.target}: {pack(given.datasets, given.target) / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
