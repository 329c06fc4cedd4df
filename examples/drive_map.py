# SPDX-License-Identifier: MIT
"""Write the map of a drive: one coloured point per voxel, without movable classes.

The labels and the poses are those of `salsanext fuse`. The map is a PLY cloud in the frame of the
poses, with coordinates in double precision. In each voxel, the point with the least range remains.

Run: python examples/drive_map.py out/fused/sequences/00 data/sequences/00 map.ply --voxel 0.1
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import salsanext_cli as sn
from salsanext_cli.runs.drives.drive_record import recorded_drive
from salsanext_cli.runs.scans.scan_search import find_scans


def points_of_scan(scan: Path, labels: Path, pose: Any, space: sn.LabelSpace) -> dict[str, Any]:
    """Return the labelled points of a scan that are not movable, in the frame of the poses."""
    cloud = sn.read_scan(scan)
    raw = sn.read_labels(labels, len(cloud))
    train = space.to_train(raw, source=labels)
    chosen = np.isfinite(cloud.points).all(axis=1) & (train > 0) & ~space.movable[train]
    points = cloud.points[chosen].astype(float)
    columns = dict(zip("xyz", (points @ pose[:, :3].T + pose[:, 3]).T, strict=True))
    columns |= zip(("red", "green", "blue"), space.colours[train[chosen]].T, strict=True)
    columns |= {"label": raw[chosen] & 0xFFFF, "intensity": cloud.intensity[chosen]}
    return columns | {"range": np.linalg.norm(points, axis=1)}


def one_per_voxel(columns: dict[str, Any], size: float) -> dict[str, Any]:
    """Return the point of each voxel that was measured from the least range."""
    cells = np.floor(np.stack([columns[axis] for axis in "xyz"]) / size)
    order = np.lexsort((columns["range"], *cells))
    is_first = np.any(np.diff(cells[:, order], prepend=np.nan) != 0, axis=0)
    return {name: values[order[is_first]] for name, values in columns.items()}


def poses_of(folder: Path) -> dict[str, Any]:
    """Return the poses (3, 4) of the scans of the largest part of a fused drive, by name."""
    if (drive := recorded_drive(folder)) is None:
        hint = "run `salsanext fuse OUT`, and give OUT/fused/sequences/NAME"
        sys.exit(f"error: {folder}: contains no results of `fuse`\nhint: {hint}")
    names = json.loads((folder / "drive.json").read_bytes())["scans"]
    largest = np.bincount(drive.parts).argmax()
    poses = {n: drive.poses[i, :3] for i, n in enumerate(names) if drive.parts[i] == largest}
    if len(poses) < len(names):
        text = f"{len(poses)} of {len(names)} scans: the poses do not connect the others"
        print(f"warning: {text}", file=sys.stderr)
    return poses


def main(fused: Path, scans: Path, target: Path, size: float, classes: str) -> None:
    if not 0.01 <= size <= 10:
        sys.exit(f"error: --voxel {size}: is not from 0.01 to 10 metres")
    if target.exists() or target.suffix != ".ply":
        sys.exit(f"error: {target}: is not a new .ply file\nhint: choose another name")
    files, space = find_scans(scans), sn.label_space(classes)
    space.require_movable("--label-space")
    if files[0].sequence != files[-1].sequence:
        sys.exit(f"error: {scans}: contains several sequences\nhint: give the folder of one")
    clouds, poses = [], poses_of(fused)
    for file in files:
        labels = fused / f"predictions/{file.stem}.label"
        if file.stem in poses and labels.exists():
            points = points_of_scan(file.path, labels, poses.pop(file.stem), space)
            clouds.append(one_per_voxel(points, size))
    if not clouds:
        sys.exit(f"error: {scans}: contains no scan with labels in {fused}")
    joined = {name: np.concatenate([cloud[name] for cloud in clouds]) for name in clouds[0]}
    sn.write_ply(target, columns := one_per_voxel(joined, size))
    print(f"{target}: {len(columns['x'])} points of {len(clouds)} scans")
    if poses:
        sys.exit(
            f"error: a file or labels are missing for {len(poses)} of the scans: {min(poses)} …"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("fused", type=Path, help="folder of a sequence in the results of fuse")
    parser.add_argument("scans", type=Path, help="folder of the scans of the sequence")
    parser.add_argument("target", type=Path, help="new .ply file")
    parser.add_argument("--voxel", type=float, default=0.1, help="edge of a voxel, metres")
    parser.add_argument("--label-space", default="semantic-kitti", help="name or .yaml file")
    try:
        main(*vars(parser.parse_args()).values())
    except sn.SalsanextError as error:
        sys.exit(f"error: {error}")
