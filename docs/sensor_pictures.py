# SPDX-License-Identifier: MIT
"""Draw scans of several sensors from above, labelled with and without the default repairs.

    python docs/sensor_pictures.py FOLDER NAME=SCAN...

writes FOLDER/NAME.webp for each scan, and prints what was found of its sensor. The pictures of
docs/how-to/sensors.md were made so.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path

from shrink import shrink

import salsanext_cli as sn
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.fitting.field_of_view import view_text
from salsanext_cli.fitting.sensor_fit import ScanSample, fit_scans
from salsanext_cli.geometry.projection import in_sensor_frame
from salsanext_cli.report.colours import Colours, legend_of, screen_colours
from salsanext_cli.report.scan_pictures import scan_picture
from salsanext_cli.results.paths import find_scans

WIDTH_PX = 1000
"""Width of a picture, so that twenty of them stay small."""
WAYS = {
    "as it is: --intensity raw, the view of the weights": NetworkSettings(
        fit=False, intensity="raw"
    ),
    "default: --intensity auto --sensor auto": NetworkSettings(),
}


def main(folder: Path, named_scans: list[str]) -> None:
    """Draw a picture of each scan."""
    network = NetworkSettings().load()
    folder.mkdir(parents=True, exist_ok=True)
    for named in named_scans:
        name, _, path = named.partition("=")
        draw(folder / f"{name}.webp", Path(path), network)


def draw(picture: Path, path: Path, network: Network) -> None:
    """Label a scan in both ways, and draw these beside each other."""
    space = network.card.space
    scan = sn.read_scan(path, network.sensor)
    labels = {}
    for title, settings in WAYS.items():
        used = fit_scans(settings, network, ScanSample(find_scans(path), network.sensor))
        image = sn.project(scan, used.sensor)
        pixel_labels = used.probabilities(image).argmax(axis=0)
        labels[title] = sn.knn_refine(image, pixel_labels, space.class_count)
    of_classes = screen_colours(space)
    views: dict[str, Colours] = {title: of_classes[ids] for title, ids in labels.items()}
    points = in_sensor_frame(scan, used.sensor).points
    legend = legend_of(space, *labels.values())
    png = scan_picture(f"{picture.stem}   {len(scan):,} points", points, views, legend=legend)
    shrink(BytesIO(png), picture, WIDTH_PX)
    print(f"{picture.stem}: {len(scan)} points; {view_text(used.sensor)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
