# SPDX-License-Identifier: MIT
"""Picture of a scan and its results: from above and as strips of its range image."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.projection import pixels_from_points, project
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, printable
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import (
    EMPTY,
    OUTCOME_LEGEND,
    Colours,
    Legend,
    PointColours,
    Scale,
    Scales,
    legend_of,
    map_on_dark,
)
from salsanext_cli.runs.results.folder_names import COLOURINGS
from salsanext_cli.runs.results.scan_results import HEIGHT, ScanResults, picture_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_PX = 2048
NARROW_PX = 1024
HEAD_PX = 56
VIEW_TITLE_PX = 40  # Height of the title of a view
STRIP_TITLE_PX = 34  # Height of the title of a strip
BAR_PX = 160  # Width of a colour bar with its numbers
STRIP_HEIGHT_PX = 128  # Twice the 64 rows of an HDL-64
MAX_IN_A_ROW = 4
OVERSAMPLING = 2
CAPTION_LINE_PX = 26
GRIDS_M = {5.0: 1.0, 10.0: 2.0, 20.0: 5.0, 45.0: 10.0}
"""Possible distances from the middle to an edge, and between two circles, metres."""
INSIDE = 0.99  # Least share of the points inside the picture of a small scan
WIDE_GRIDS_M = {45.0: 10.0, 100.0: 20.0, 250.0: 50.0, 600.0: 100.0, 1500.0: 250.0}
"""The same for scans of larger areas, such as surveys."""
MOST_INSIDE = 0.85  # Least share of the points inside the picture of such a scan
FAR = 4  # A picture that need not reach so many times as far is around the points
RASTER_POINTS = 2**18  # Points that are drawn at a time, so that a large scan needs little memory
TITLES = {
    "label": "prediction",
    "wrong": "errors of the prediction",
    HEIGHT: "height above the sensor",
    **{name: kind.title for name, kind in UNCERTAINTY.items()},
}
UNITS = {"range": "m", HEIGHT: "m", **{name: kind.unit for name, kind in UNCERTAINTY.items()}}


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """What a picture from above shows."""

    middle: tuple[float, float] | None  # x and y, metres; None for the sensor
    reach: float  # Distance from the middle to an edge, metres; one of `_grids`

    def around(self, points: Float) -> Float:
        """Return points (N, 3) relative to the middle."""
        return points if self.middle is None else points - np.array([*self.middle, 0], np.float32)


class Strip(NamedTuple):
    """Picture of a range image."""

    title: str
    picture: Colours  # (H, W, 3) uint8: red, green, blue of every pixel; row 0 is the highest beam
    scale: Scale | None = None  # Of the colour bar
    unit: str = ""  # Of the scale


def picture_of_results(
    name: str,
    results: ScanResults,
    space: LabelSpace,
    sensor: Sensor,
    scales: Scales,
    views: Collection[str],
    strips: Collection[str],
) -> bytes:
    """Draw a scan as a PNG: `views` from above and `strips` of its range image, by colour."""
    columns = picture_columns(results, space)
    sensor = results.sensor or sensor
    image = project(results.scan, sensor)
    drawn_columns = dict.fromkeys([*views, *strips])
    view_colours: dict[str, Colours] = {}
    strip_list: list[Strip] = []
    for colour in drawn_columns:
        scale = scales.get(colour)
        colours = PointColours(
            colour=colour, scale=scale or (0.0, 1.0), space=space, dark=True
        ).rgb(columns)
        title = TITLES.get(colour, colour)
        accepted = results.accepted_text(space) if colour == "wrong" else ""
        if accepted:
            title = f"errors of the accepted labels: {accepted}"
        if colour in views:
            view_colours[title] = colours
        if colour in strips:
            pixels = pixels_from_points(colours, image.point_of_pixel, EMPTY)
            strip_list.append(Strip(title, pixels, scale, UNITS.get(colour, "")))
    label_columns = [name for name in ("label", "truth") if name in drawn_columns]
    labels = [space.to_train(columns[name], strict=False) for name in label_columns]
    legend: list[tuple[str, tuple[int, int, int]]] = []
    absent: set[str] = set()
    if labels:
        legend += legend_of(space, np.arange(space.class_count))
        absent = {*space.names} - dict(legend_of(space, *labels)).keys()
    if "wrong" in drawn_columns:
        legend += OUTCOME_LEGEND
    classes = f"classes of {space.name}   " if labels else ""
    heading = f"{name}   {counted(len(results.scan), 'point')}   {classes}sensor {sensor.name}"
    points = in_sensor_frame(results.scan, sensor).points
    return scan_picture(
        printable(heading),
        points,
        view_colours,
        strip_list,
        legend,
        absent,
        caption=() if _has_results(columns) else _caption(sensor, _frame(points)),
    )


def columns_from_above(columns: Collection[str]) -> list[str]:
    """Return two to four columns to show from above: labels, errors, uncertainty, measurements."""
    views = [colour for colour in ("truth", "label", "wrong") if colour in columns]
    views += [kind for kind in ("error", "entropy", *UNCERTAINTY) if kind in columns][:1]
    if not _has_results(columns):
        return [*views, HEIGHT, "intensity"]
    return (views + ["intensity", "range"])[: max(2, len(views))]


def columns_of_strips(columns: Collection[str]) -> list[str]:
    """Return the columns to show as range images: all, and the height of a scan alone."""
    heights = () if _has_results(columns) else (HEIGHT,)
    return [colour for colour in (*heights, *COLOURINGS) if colour in columns]


def _has_results(columns: Collection[str]) -> bool:
    """Return whether there are labels or uncertainties of a network among columns."""
    return not {"label", *UNCERTAINTY}.isdisjoint(columns)


def _caption(sensor: Sensor, frame: Frame) -> list[str]:
    """Describe the pictures of a scan alone, which may be the first ones that somebody sees."""
    view = f"{sensor.fov_up:+.3g}° at the top to {sensor.fov_down:+.3g}° at the bottom"
    middle = "ahead (x) is up, and the triangle is the sensor"
    if frame.middle is not None:
        x, y = frame.middle
        middle = f"x is up, around the middle of the points at x {x:,.0f} m, y {y:,.0f} m"
    return [
        f"From above: {middle}. The circles are {_grids()[frame.reach]:g} m apart. "
        "Higher points hide lower ones.",
        f"Range images: {sensor.height} rows of beams, from {view}, and {sensor.width} columns "
        "all around. Ahead is in the middle, left a quarter from the left edge, behind at both "
        "edges.",
        "Colours of values: violet is low, yellow is high. Values beyond an end of the scale have "
        "its colour. Grey: no measurement.",
    ]


def scan_picture(
    heading: str,
    points: Float,
    views: Mapping[str, Colours],
    strips: Sequence[Strip] = (),
    legend: Legend = (),
    absent: Collection[str] = (),
    caption: Sequence[str] = (),
) -> bytes:
    """Draw views of a scan from above, strips and a legend below each other, as a PNG.

    Parameters
    ----------
    heading : str
        First line.
    points : (N, 3) float32
        Points in the frame of the sensor, in metres.
    views : mapping of str to (N, 3) uint8
        Colours of the points by the title of a view.
    strips : sequence of Strip
        Pictures of range images.
    legend : sequence of (str, colour)
        Entries of the legend.
    absent : collection of str
        Its faint entries.
    caption : sequence of str
        Lines of text below the strips.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    frame = _frame(points)
    width = NARROW_PX if len(views) == 1 else WIDTH_PX
    in_row = max(1, min(len(views), MAX_IN_A_ROW))
    size = (width - (in_row - 1) * MARGIN_PX) // in_row
    row_px = VIEW_TITLE_PX + size
    top = HEAD_PX + -(-len(views) // in_row) * row_px
    height = top + len(strips) * (STRIP_TITLE_PX + STRIP_HEIGHT_PX) + MARGIN_PX
    height += len(caption) * CAPTION_LINE_PX
    bars = any(strip.scale for strip in strips)
    full_width = MARGIN_PX + width + (BAR_PX if bars else MARGIN_PX)
    figure = canvas.new_picture(full_width, height, legend, width, absent)
    canvas.text_at(figure, MARGIN_PX, HEAD_PX // 2, heading, 22)
    for i, (title, colours) in enumerate(views.items()):
        left = MARGIN_PX + i % in_row * (size + MARGIN_PX)
        view_top = HEAD_PX + i // in_row * row_px
        canvas.text_at(figure, left, view_top + VIEW_TITLE_PX // 2, title, 18)
        axes = canvas.axes_at(figure, left, view_top + VIEW_TITLE_PX, size, size)
        _draw_from_above(axes, frame.around(points), colours, size, frame)
    for strip in strips:
        canvas.text_at(figure, MARGIN_PX, top + STRIP_TITLE_PX // 2 + 2, strip.title, 18)
        top += STRIP_TITLE_PX
        canvas.show_pixels(figure, strip.picture, MARGIN_PX, top, width, STRIP_HEIGHT_PX)
        if strip.scale:
            _draw_bar(figure, strip.scale, strip.unit, MARGIN_PX + width + 16, top)
        top += STRIP_HEIGHT_PX
    for line in caption:
        top += CAPTION_LINE_PX
        canvas.text_at(figure, MARGIN_PX, top, line, 15, canvas.FAINT)
    return canvas.png_of(figure)


def _frame(points: Float) -> Frame:
    """Return what to show of points (N, 3): the surroundings of the sensor, else of the points."""
    reach = _reach(points)
    measured = points[np.isfinite(points).all(axis=1) & points.any(axis=1), :2]
    if len(measured):
        x, y = np.median(measured, axis=0).tolist()
        around = Frame(middle=(x, y), reach=0.0)
        reach_around = _reach(around.around(points))
        if FAR * reach_around <= reach:
            return replace(around, reach=reach_around)
    return Frame(middle=None, reach=reach)


def _reach(points: Float) -> float:
    """Return the least of the possible distances, in metres, that shows most points (N, 3).

    A small scan is shown nearly whole, the sparse far points of others are not.
    """
    distances = np.abs(points[:, :2]).max(axis=1)
    distances = distances[(distances > 0) & np.isfinite(distances)]
    if not len(distances):
        return max(GRIDS_M)
    for reach in GRIDS_M:
        if (distances < reach).mean() >= INSIDE:
            return reach
    for reach in WIDE_GRIDS_M:
        if (distances < reach).mean() >= MOST_INSIDE:
            return reach
    return max(WIDE_GRIDS_M)


def _grids() -> dict[float, float]:
    """Return the distance between two circles by the distance to an edge, metres."""
    return GRIDS_M | WIDE_GRIDS_M


def _draw_bar(figure: Figure, scale: Scale, unit: str, left: int, top: int) -> None:
    low = scale[0]
    high = scale[-1]
    marks = scale if len(scale) > 2 else (low, (low + high) / 2, high)
    height = STRIP_HEIGHT_PX
    rows = np.linspace(255, 0, height).round().astype(np.intp)
    canvas.show_pixels(figure, map_on_dark()[rows][:, None], left, top, 16, height)
    # Digits depend on the span of the scale: its lower end is "0" rather than "0.00035".
    digits = 2 - math.floor(math.log10(max(high - low, 1e-9)))
    for value, down in zip(marks, np.linspace(height - 9, 9, len(marks)), strict=True):
        text = f"{round(value, digits):.4g} {unit}".strip()
        canvas.text_at(figure, left + 24, top + down, text, 15)


def raster(points: Float, colours: Colours, reach: float, size: int, spread: int = 1) -> Colours:
    """Draw points (N, 3), metres, from above, higher points last: (size, size, 3) uint8.

    x, forward, points up, y left; `reach`: metres from the middle to an edge; `spread`: size of a
    point in pixels.
    """
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    order = finite[np.argsort(points[finite, 2], kind="stable")]
    corner = np.floor((reach - points[order, :2].astype(np.float64)) * size / (2 * reach))
    inside = ((corner > -spread) & (corner < size)).all(axis=1)
    row, column = corner[inside].astype(np.intp).T
    edge = size + 2 * spread
    picture = np.full((edge, 3), EMPTY, np.uint8)[None].repeat(edge, axis=0)
    # All pixels of a point come before the next point, which hides it.
    across, down = np.meshgrid(np.arange(spread), np.arange(spread))
    drawn = order[inside]
    for start in range(0, len(drawn), RASTER_POINTS):
        part = slice(start, start + RASTER_POINTS)
        rows = (row[part, None] + down.ravel() + spread).ravel()
        columns = (column[part, None] + across.ravel() + spread).ravel()
        picture[rows, columns] = colours[drawn[part]].repeat(spread**2, axis=0)
    return picture[spread : size + spread, spread : size + spread]


def averaged(large: Colours) -> Colours:
    """Return the means of blocks of pixels, `OVERSAMPLING` in each direction: (H, W, 3) uint8."""
    size = len(large) // OVERSAMPLING
    blocks = large.reshape(size, OVERSAMPLING, -1, OVERSAMPLING, 3)
    sums = np.zeros((size, blocks.shape[2], 3), np.float32)
    # `blocks.mean` takes four times as long, since its inner loops are short.
    for down in range(OVERSAMPLING):
        for across in range(OVERSAMPLING):
            sums += blocks[:, down, :, across]
    return (sums / OVERSAMPLING**2).round().astype(np.uint8)


def _draw_from_above(axes: Axes, points: Float, colours: Colours, size: int, frame: Frame) -> None:
    """Draw points relative to the middle from above, circles around it, and the sensor if there."""
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    reach = frame.reach
    # Drawing larger and averaging makes the edges of points soft.
    large = raster(points, colours, reach, size * OVERSAMPLING, spread=3)
    axes.set_axis_off()
    axes.imshow(averaged(large), extent=(reach, -reach, -reach, reach), interpolation="nearest")
    outline = [withStroke(linewidth=2.5, foreground=canvas.NIGHT)]
    step = _grids()[reach]
    for radius in np.arange(step, reach * 2**0.5, step):
        axes.add_patch(Circle((0, 0), radius, fill=False, ec=canvas.FAINT, lw=0.6, alpha=0.55))
        if radius < reach:
            diagonal = radius * 0.5**0.5
            text = f"{radius:g} m"
            axes.text(-diagonal, diagonal, text, color=canvas.INK, fontsize=8, path_effects=outline)
    if frame.middle is None:
        axes.plot(0, 0, color=canvas.INK, marker="^", markersize=8)
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
