# SPDX-License-Identifier: MIT
"""Picked scans as a table, as the reasons in words, and as a sheet of pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table

from salsanext_cli.classes.label_space import LabelSpace, RawIds, TrainIds
from salsanext_cli.errors import counted, printable
from salsanext_cli.fitting.label_scan import LabelledScan
from salsanext_cli.formats.ply import encode_ply
from salsanext_cli.geometry.projection import pixels_from_points, points_from_pixels
from salsanext_cli.labelling.picked_data_set import PickedScan
from salsanext_cli.labelling.scan_choice import Choice
from salsanext_cli.records import Float
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import (
    EMPTY,
    legend_of,
    map_on_dark,
    screen_colours,
    value_colours,
    value_range,
)
from salsanext_cli.report.tables import ABSENT, table_of
from salsanext_cli.results.layout import ScanFile

STRIP_WIDTH_PX, STRIP_HEIGHT_PX = 1024, 96
TITLE_PX, HEAD_PX, BAR_PX = 34, 44, 200
MAX_ON_SHEET = 200  # Scans of a sheet; PNG cannot be high enough for many more
NO_CLASS = 255


@dataclass(frozen=True, slots=True, eq=False)
class PickedLabels:
    """Labels that the network guesses of a picked scan, and strips of at most `STRIP_WIDTH_PX`."""

    file: ScanFile
    raw: RawIds  # (N,) uint32
    classes: TrainIds  # (H, W) uint8: train ids, `NO_CLASS` where empty
    uncertainty: Float  # (H, W) float32: NaN where empty

    @classmethod
    def of(cls, labelled: LabelledScan, uncertainty: Float, space: LabelSpace) -> PickedLabels:
        """Take every so many columns of a scan's range image and of its pixels' uncertainty."""
        image, step = labelled.image, -(-labelled.image.width // STRIP_WIDTH_PX)
        classes = pixels_from_points(labelled.labels, image.point_of_pixel, NO_CLASS)
        values = np.where(image.point_of_pixel < 0, np.float32(np.nan), uncertainty)
        raw = space.to_raw(labelled.labels)
        return cls(labelled.file, raw, classes[:, ::step].copy(), values[:, ::step].copy())


def picked_cloud(labelled: LabelledScan, uncertainty: Float, space: LabelSpace) -> bytes:
    """Return a PLY of a scan, coloured by its labels, with scalars that CloudCompare shows."""
    scan, labels = labelled.scan, labelled.labels
    columns: dict[str, npt.NDArray[Any]] = dict(zip("xyz", scan.points.T, strict=True))
    columns |= zip(("red", "green", "blue"), space.colours[labels].T, strict=True)
    # CloudCompare takes properties of such names for scalars, without asking.
    columns["scalar_label"] = space.to_raw(labels)
    pixels = labelled.image.pixel_of_point
    columns["scalar_uncertainty"] = points_from_pixels(uncertainty, pixels, np.nan)
    columns["scalar_intensity"] = scan.intensity
    return encode_ply(columns, ["scalar_label: raw ids of labels.yaml"])


def reason(choice: Choice, rank: int, strategy: str, scans: int, nearest: str | None) -> str:
    """Say why a scan was picked at a rank, from 1, of so many; `nearest`: scan picked before."""
    if scans == 1:
        return "the only scan"
    if strategy == "random":
        return "drawn at random"
    if nearest is None:
        first = "most typical" if strategy == "diverse" else "most uncertain"
        return f"{first} of {counted(scans, 'scan')}"
    if choice.distance == 0:
        return f"equal to {nearest}; no other is left"
    place = f"{choice.distance:.2f} from {nearest}"
    if strategy == "diverse":
        return f"farthest from those before: {place}"
    uncertain = f"number {choice.uncertainty_rank} of {scans:,} by uncertainty"
    if strategy == "both":
        return f"{uncertain}, {place}"
    passed = "; nearly equal ones passed over" if choice.uncertainty_rank > rank else ""
    return f"{uncertain}{passed}"


def picked_scans(
    choices: Sequence[Choice], files: Sequence[ScanFile], strategy: str
) -> list[PickedScan]:
    """Return the chosen ones of some scans, with the reasons in words."""
    picked = []
    for rank, choice in enumerate(choices, start=1):
        file, nearest, distance = files[choice.scan], None, None
        if choice.nearest is not None:
            before, distance = files[choice.nearest], choice.distance
            nearest = before.name
        why = reason(choice, rank, strategy, len(files), nearest)
        of_choice = (choice.uncertainty, distance, nearest, why)
        picked.append(PickedScan(rank, file.sequence, file.stem, *of_choice))
    return picked


def picked_table(picked: Sequence[PickedScan], unit: str = "nats") -> Table:
    """Return a table with a row per picked scan, the one most worth labelling first."""
    rows = []
    for each in picked:
        distance = ABSENT if each.distance is None else f"{each.distance:.2f}"
        rows.append((str(each.rank), each.name, f"{each.uncertainty:.4f}", distance, each.reason))
    headings = ("rank", "scan", f"uncertainty,\n{unit}", "distance", "reason")
    return table_of(headings, rows, texts=("scan", "reason"))


def picked_csv(picked: Sequence[PickedScan]) -> bytes:
    """Return the content of a CSV file with a row per picked scan."""
    text = io.StringIO()
    names = [field.name for field in fields(PickedScan)]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(each) for each in picked)
    return text.getvalue().encode("utf-8", "backslashreplace")


def picked_sheet(
    picked: Sequence[PickedScan], labels: Sequence[PickedLabels], space: LabelSpace
) -> bytes:
    """Return a PNG: classes and uncertainty of the first picked scans, with ranks and reasons."""
    labels = labels[:MAX_ON_SHEET]
    low, high = value_range(np.concatenate([each.uncertainty.ravel() for each in labels]))
    classes = [each.classes[each.classes != NO_CLASS] for each in labels]
    right = MARGIN_PX + STRIP_WIDTH_PX + MARGIN_PX
    width, row_px = right + STRIP_WIDTH_PX + MARGIN_PX, TITLE_PX + STRIP_HEIGHT_PX
    height = HEAD_PX + len(labels) * row_px + MARGIN_PX
    figure = canvas.new_picture(width, height, legend_of(space, *classes), width - MARGIN_PX)
    canvas.text_at(figure, MARGIN_PX, HEAD_PX // 2, "labels", 18)
    _draw_scale(figure, low, high, right, width - MARGIN_PX)
    colours = np.full((NO_CLASS + 1, 3), EMPTY, np.uint8)
    colours[: space.class_count] = screen_colours(space)
    for top, each, strips in zip(range(HEAD_PX, height, row_px), picked, labels, strict=False):
        title = printable(f"{each.rank}   {each.name}   {each.reason}")
        canvas.text_at(figure, MARGIN_PX, top + TITLE_PX // 2 + 2, title, 17)
        values = value_colours(strips.uncertainty, low, high)
        for left, strip in ((MARGIN_PX, colours[strips.classes]), (right, values)):
            size = STRIP_WIDTH_PX, STRIP_HEIGHT_PX
            canvas.show_pixels(figure, strip, left, top + TITLE_PX, *size)
    return canvas.png_of(figure)


def _draw_scale(figure: Any, low: float, high: float, left: int, right: int) -> None:
    middle = HEAD_PX // 2
    canvas.text_at(figure, left, middle, "uncertainty: mutual information, nats", 18)
    start = right - BAR_PX - 70
    canvas.text_at(figure, start - 60, middle, f"{low:.3f}", 15)
    canvas.show_pixels(figure, map_on_dark()[None], start, middle - 8, BAR_PX, 16)
    canvas.text_at(figure, start + BAR_PX + 10, middle, f"{high:.3f}", 15)
