# SPDX-License-Identifier: MIT
"""Draw scans of several sensors from above, labelled with and without the default repairs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path

import salsanext_cli as sn
from pictures.shrink import shrink
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.report.colours import Colours, legend_of, screen_colours
from salsanext_cli.report.scan_pictures import scan_picture

WIDTH_PX = 1000
"""Width of a picture, so that many of them stay small."""
SCANS = {
    "hdl64": "semantickitti/sequences/00/velodyne/000000.bin",
    "pandar64": "pandaset/sequences/002/velodyne/000059.bin",
    "hdl32": "sensors/nuscenes_hdl32/four_columns/velodyne/000000.bin",
    "os0-128": "sensors/ouster/os0_128.bin",
    "os1-128": "sensors/ouster/os1_128.bin",
    "os1": "sensors/pcd/os1_ascii_half_zeros.pcd",
    "os2-32": "sensors/ouster/os2_32.bin",
    "beams128": "sensors/pcd/beams128_binary_compressed.pcd",
    "ring40": "sensors/pcd/ring40_padding_fields.pcd",
    "livox": "sensors/pcd/livox_front.pcd",
    "velodyne64-u1": "sensors/pcd/velodyne64_u1_intensity.pcd",
    "hdl64-s3": "sensors/five_columns_hdl64s3.bin",
    "hdl32-origin": "sensors/pcd/hdl32_with_points_at_origin.pcd",
    "xyz": "sensors/ply/float64_xyz_only.ply",
}
"""Scan of each sensor, in the folder of the real data."""
COLUMNS = {"hdl64-s3": ("x", "y", "z", "intensity", "_")}
"""Columns of scans whose files do not state them."""


@cache
def network() -> sn.Network:
    """Return the default weights, loaded once."""
    return sn.load_network()


def draw(data: Path, picture: Path) -> None:
    """Draw a scan from above, labelled as it is and with the fitted sensor and intensity."""
    name, space = picture.stem, network().card.space
    sensor = replace(network().sensor, columns=COLUMNS.get(name, ()))
    scan = sn.read_scan(data / SCANS[name], sensor)
    fitted = sn.fit_network(network(), [scan])
    labels = {}
    for title, used in {"as it is": network(), "default: fitted": fitted}.items():
        image = sn.project(scan, used.sensor)
        pixel_labels = used.probabilities(image).argmax(axis=0)
        labels[title] = sn.knn_refine(image, pixel_labels, space.class_count)
    of_classes = screen_colours(space)
    colours: dict[str, Colours] = {title: of_classes[ids] for title, ids in labels.items()}
    points = in_sensor_frame(scan, fitted.sensor).points
    legend = legend_of(space, *labels.values())
    png = scan_picture(f"{name}   {len(scan):,} points", points, colours, legend=legend)
    picture.parent.mkdir(exist_ok=True)
    shrink(BytesIO(png), picture, WIDTH_PX)
