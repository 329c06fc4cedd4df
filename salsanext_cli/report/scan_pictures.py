# SPDX-License-Identifier: MIT
"""Picture of a scan: from above and as strips of its range image, by everything known of it."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, printable
from salsanext_cli.geometry.projection import in_sensor_frame, project
from salsanext_cli.records import Float
from salsanext_cli.report import birds_eye, canvas, panel
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import (
    OUTCOME_LEGEND,
    Colours,
    Legend,
    PointColours,
    legend_of,
)
from salsanext_cli.report.panel import Strip, coloured_strip, draw_strips
from salsanext_cli.report.scales import Scales
from salsanext_cli.results.layout import UNCERTAINTY
from salsanext_cli.results.result_folder import ScanResults, scalar_columns
from salsanext_cli.sensors.sensor import Sensor

WIDTH_PX, NARROW_PX = 2048, 1024
"""Width of a strip, and beside a single view."""
HEAD_PX = 56
MAX_IN_A_ROW = 4
TITLES = {
    "label": "prediction",
    "wrong": "errors of the prediction",
    "error": "error: probability that the label is wrong",
    "epistemic": "epistemic uncertainty",
    "aleatoric": "aleatoric uncertainty",
    "total": "total uncertainty",
    "entropy": "uncertainty: entropy of the classes",
    "mutual_information": "uncertainty: mutual information",
}
UNITS = {"range": "m", "entropy": "nats", "mutual_information": "nats"}


def picture_of_results(
    name: str,
    results: ScanResults,
    space: LabelSpace,
    sensor: Sensor,
    scales: Scales,
    views: Collection[str],
    strips: Collection[str],
) -> bytes:
    """Draw a scan and its results.

    `name`: name of the scan, for the heading; `results`: the scan and what is known of it; `space`:
    meaning of the labels; `sensor`: sensor of the range image; `scales`: values at the ends of the
    colour map, by colour; `views`, `strips`: of `COLOURINGS`, all known: those seen from above, and
    those of the range image.

    It is a PNG.
    """
    columns = scalar_columns(results, space)
    image = project(results.scan, sensor)
    seen: dict[str, Colours] = {}
    drawn: list[Strip] = []
    for colour in dict.fromkeys((*views, *strips)):
        scale = scales.get(colour)
        ways = PointColours(colour, scale or (0.0, 1.0), space, dark=True)
        colours = ways.of_points(columns)
        title, unit = TITLES.get(colour, colour), UNITS.get(colour, "")
        if colour in views:
            seen[title] = colours
        if colour in strips:
            pixels = coloured_strip(image, title, colours).picture
            drawn.append(Strip(title, pixels, scale, unit))
    shown = {colour for colour in (*views, *strips) if colour in ("label", "truth")}
    labels = [space.to_train(columns[colour], strict=False) for colour in shown]
    legend = legend_of(space, np.arange(space.class_count)) if shown else ()
    present = {entry for entry, _ in legend_of(space, *labels)} if shown else set()
    absent = {entry for entry, _ in legend} - present
    if "wrong" in (*views, *strips):
        legend = [*legend, *OUTCOME_LEGEND]
    of_classes = f"classes of {space.name}   " if shown else ""
    heading = f"{name}   {counted(len(results.scan), 'point')}   {of_classes}sensor {sensor.name}"
    points = in_sensor_frame(results.scan, sensor).points
    return scan_picture(printable(heading), points, seen, drawn, legend, absent)


def known_views(columns: Collection[str]) -> list[str]:
    """Return what a picture shows from above, out of all columns known of a scan: 2 to 4 of them.

    These are labels, errors and an uncertainty; measurements where there are too few of those.
    """
    views = [colour for colour in ("truth", "label", "wrong") if colour in columns]
    views += [kind for kind in ("error", "entropy", *UNCERTAINTY) if kind in columns][:1]
    return (views + ["intensity", "range"])[: max(2, len(views))]


def scan_picture(
    heading: str,
    points: Float,
    views: Mapping[str, Colours],
    strips: Sequence[Strip] = (),
    legend: Legend = (),
    absent: Collection[str] = (),
) -> bytes:
    """Draw a scan from above and its strips below that, as a PNG.

    `heading`: first line; `points` (N, 3) float32, metres, sensor frame; `views`: colours of the
    points from above, by title; `strips`: from top to bottom; `legend`: entries of the legend at
    the bottom; `absent`: entries that the picture does not show.
    """
    width = NARROW_PX if len(views) == 1 else WIDTH_PX
    in_row = max(1, min(len(views), MAX_IN_A_ROW))
    size = (width - (in_row - 1) * MARGIN_PX) // in_row
    row_px = birds_eye.TITLE_PX + size
    top = HEAD_PX + -(-len(views) // in_row) * row_px
    height = top + len(strips) * (panel.TITLE_PX + panel.STRIP_HEIGHT_PX) + MARGIN_PX
    bars = any(strip.scale for strip in strips)
    full_width = MARGIN_PX + width + (panel.BAR_PX if bars else MARGIN_PX)
    figure = canvas.new_picture(full_width, height, legend, width, absent)
    canvas.text_at(figure, MARGIN_PX, HEAD_PX // 2, heading, 22)
    for i, (title, colours) in enumerate(views.items()):
        left = MARGIN_PX + i % in_row * (size + MARGIN_PX)
        place = (left, HEAD_PX + i // in_row * row_px, size)
        birds_eye.draw_view(figure, points, title, colours, *place)
    draw_strips(figure, strips, top, width)
    return canvas.png_of(figure)
