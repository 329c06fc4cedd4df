# SPDX-License-Identifier: MIT
"""Draw the pipeline of the front page: commands, and the files between them.

Boxes have background colours, so that they can be read on light and on dark pages.
"""

from html import escape
from pathlib import Path
from typing import NamedTuple

WIDTH, HEIGHT, ACROSS, DOWN, MARGIN = 128, 48, 148, 80, 4
"""Size of a box, steps to the next one, and the margin, in pixels."""
COMMAND, FILES, ARROW = ("#00656f", "#ffffff"), ("#dfe5ea", "#1d2127"), "#7d8794"
"""Fill and text of a command and of files, and the colour of arrows."""


class Box(NamedTuple):
    """A box: its place in columns and rows, its colours, its text, and the columns it fills."""

    column: int
    row: int
    colours: tuple[str, str]
    text: str
    below: str = ""
    columns: int = 1

    @property
    def width(self) -> int:
        """Width in pixels."""
        return WIDTH + (self.columns - 1) * ACROSS

    @property
    def middle(self) -> tuple[float, float]:
        """Place of its middle in pixels."""
        left, top = MARGIN + self.column * ACROSS, MARGIN + self.row * DOWN
        return left + self.width / 2, top + HEIGHT / 2


BOXES = {
    "labels": Box(0, 0, FILES, "labels"),
    "train": Box(1, 0, COMMAND, "train"),
    "weights": Box(2, 0, FILES, "weights"),
    "scans": Box(0, 1, FILES, "scans", ".bin .pcd .ply …"),
    "project": Box(1, 1, COMMAND, "project"),
    "images": Box(2, 1, FILES, "range images"),
    "predict": Box(3, 1, COMMAND, "predict"),
    "pixels": Box(4, 1, FILES, "pixel labels"),
    "uncertainty": Box(1, 2, COMMAND, "uncertainty"),
    "values": Box(2, 2, FILES, "uncertainties", "of every point"),
    "knn": Box(4, 2, COMMAND, "knn-refine"),
    "results": Box(2, 3, COMMAND, "eval, report, export-ply", "scores, a page, point clouds", 2),
    "points": Box(4, 3, FILES, "point labels"),
}
ARROWS = (
    *("labels train", "scans train", "train weights", "weights predict", "scans project"),
    *("project images", "images predict", "predict pixels", "pixels knn", "knn points"),
    *("scans uncertainty", "uncertainty values", "values results", "points results"),
)


def drawn(box: Box) -> str:
    """Return a box with its one or two lines."""
    x, y = box.middle
    fill, ink = box.colours
    place = (
        f'x="{x - box.width / 2:g}" y="{y - HEIGHT / 2:g}" width="{box.width}" height="{HEIGHT}"'
    )
    parts = [f'<rect {place} rx="6" fill="{fill}"/>']
    for text, size, down in ((box.text, 17, -3 if box.below else 6), (box.below, 13, 15)):
        at = f'x="{x:g}" y="{y + down:g}" font-size="{size}" fill="{ink}"'
        parts += [f"<text {at}>{escape(text)}</text>"] * bool(text)
    return "".join(parts)


def arrow(start: Box, end: Box) -> str:
    """Return an arrow from edge to edge, straight down where one box is above the other."""
    (x, y), (to_x, to_y) = start.middle, end.middle
    if start.row != end.row and abs(x - to_x) < end.width / 2:
        to_x = x
    across, down = to_x - x, to_y - y

    def edge(box: Box) -> float:
        """Return the share of the way from the middle of a box to its edge."""
        sides = [(box.width / 2, across), (HEIGHT / 2, down)]
        return min(half / abs(way) for half, way in sides if way)

    first, last = edge(start), 1 - edge(end) - 5 / (across**2 + down**2) ** 0.5
    ends = [(x + share * across, y + share * down) for share in (first, last)]
    path = " L".join(f"{a:.1f},{b:.1f}" for a, b in ends)
    return f'<path d="M{path}" stroke="{ARROW}" stroke-width="2" marker-end="url(#head)"/>'


def draw(_: Path, picture: Path) -> None:
    """Write the picture."""
    width = 2 * MARGIN + 4 * ACROSS + WIDTH
    height = 2 * MARGIN + 3 * DOWN + HEIGHT
    head = f'<path d="M0,0 L8,4 L0,8 z" fill="{ARROW}"/>'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="system-ui, sans-serif" text-anchor="middle">',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="3" refY="4" markerWidth="5" '
        f'markerHeight="5" orient="auto">{head}</marker></defs>',
        *(arrow(*(BOXES[name] for name in names.split())) for names in ARROWS),
        *map(drawn, BOXES.values()),
        "</svg>",
    ]
    picture.write_text("\n".join(parts) + "\n", "utf-8")
