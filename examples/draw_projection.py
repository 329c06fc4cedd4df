# SPDX-License-Identifier: MIT
"""Draw the range image of a scan, the input of the network.

Run: python examples/draw_projection.py 000000.bin range.png [hdl64]
"""

import sys

from matplotlib.figure import Figure

import salsanext_cli as sn


def main(scan_file: str, picture: str, sensor: str = "hdl64") -> None:
    image = sn.project(sn.read_scan(scan_file), sn.sensor(sensor))
    occupied = image.point_of_pixel >= 0
    figure = Figure(figsize=(16, 3), layout="constrained")
    rows = figure.subplots(2, 1)
    for axes, title, channel in zip(rows, ("range, metres", "intensity"), (0, 4), strict=True):
        values = image.channels[channel].copy()
        values[~occupied] = float("nan")
        shown = axes.imshow(values, aspect="auto", interpolation="nearest")
        axes.set(title=title, xticks=[], yticks=[])
        figure.colorbar(shown, ax=axes)
    figure.savefig(picture)
    print(f"{occupied.mean():.0%} of {image.height}×{image.width} pixels hold a point → {picture}")


if __name__ == "__main__":
    main(*sys.argv[1:])
