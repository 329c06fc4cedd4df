# SPDX-License-Identifier: MIT
"""Draw the pictures of the concepts from one scan of the drive that training has not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

import salsanext_cli as sn
from pictures.example import FAR_M, WIDTHS, Values, behind, example, hidden_shares
from pictures.sheets import (
    DARK,
    FAINT,
    GREY,
    INK,
    ORANGE,
    RED,
    TEXT_PT,
    colour_bar,
    from_above,
    legend,
    panels,
    save,
    sheet,
    titled,
)
from salsanext_cli.report.colours import (
    EMPTY,
    FIXED_SCALES,
    RIGHT,
    WRONG,
    legend_of,
    map_colours,
    screen_colours,
    value_colours,
)

CAR = 1
REACH_M = (32.0, 20.0)
CENTRE_M = (0.0, 4.0)
POINT = 2.2
SHADES = map_colours("bone")[np.linspace(70, 255, 256).astype(int)]
"""Colours of range and intensity; the darkest one differs from an empty pixel."""
RANGES_M = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)
INTENSITIES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
PROBABILITIES = FIXED_SCALES["error"]
NATS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
VARIANCES = (0.0, 1e-5, 1e-4, 1e-3, 0.01)
"""Marks of the colour bars."""
KINDS = {
    "error": (PROBABILITIES, "error, a probability"),
    "least_confidence": (PROBABILITIES, "least confidence"),
    "entropy": (NATS, "entropy, nats"),
    "epistemic": (VARIANCES, "epistemic, variance"),
    "mutual_information": (NATS, "mutual information, nats"),
    "aleatoric": (VARIANCES, "aleatoric, variance"),
    "total": (VARIANCES, "total, variance"),
}
"""Marks and title of each kind of uncertainty; equal units have equal marks."""


def class_colours(labels: Values, empty: npt.ArrayLike = DARK) -> Values:
    """Return the colours of train ids, (…) to (…, 3), 0 to 1."""
    colours = screen_colours(sn.label_space()) / 255
    return np.where(labels[..., None] > 0, colours[labels], empty)


def range_images(data: Path, picture: Path) -> None:
    """Draw range, intensity and labels of the range image."""
    shown = example(data)
    channels = shown.image.channels
    full = channels[0] > 0
    figure = sheet(7.8)
    axes = panels(figure, 5, 1, height_ratios=[6, 1, 6, 1, 6])
    strips = {
        "range, m: near is bright": (channels[0], RANGES_M, SHADES[::-1]),
        "intensity, from 0 to 1": (channels[4], INTENSITIES, SHADES),
    }
    for number, (title, (values, marks, shades)) in enumerate(strips.items()):
        strip = value_colours(np.where(full, values, np.nan), *marks, colour_map=shades)
        axes[2 * number].imshow(strip, aspect="auto", interpolation="nearest")
        titled(axes[2 * number], title)
        colour_bar(axes[2 * number + 1], marks, shades)
    labels = np.where(full, shown.pixel_labels, 0)
    colours = class_colours(labels, np.array(EMPTY) / 255)
    axes[4].imshow(colours, aspect="auto", interpolation="nearest")
    titled(axes[4], "predicted classes")
    legend(figure, legend_of(sn.label_space(), labels[labels > 0]), 4)
    save(figure, picture)


def hidden_points(data: Path, picture: Path) -> None:
    """Draw where points share a pixel, and how many do by the width of the image."""
    shown = example(data)
    figure = sheet(11)
    upper, lower = panels(figure, 2, 1, height_ratios=[7, 4])
    far = behind(shown.image) > FAR_M
    order = np.argsort(far)
    colours = np.where(far[:, None], _rgb(ORANGE), GREY)[order]
    from_above(upper, shown.scan.points[order], colours, CENTRE_M, REACH_M, 2 * POINT)
    titled(upper, f"from above, orange: over {FAR_M:g} m behind the nearest")
    shares = 100 * np.array([hidden_shares(data, width) for width in WIDTHS])
    place = np.arange(len(WIDTHS))
    names = ("hidden behind a nearer point", f"over {FAR_M:g} m behind it")
    for number, (name, colour) in enumerate(zip(names, (GREY, ORANGE), strict=True)):
        bars = lower.bar(place + 0.4 * number, shares[:, number], 0.38, color=colour, label=name)
        texts = [f"{share:.0f} %" for share in shares[:, number]]
        lower.bar_label(bars, texts, color=INK, fontsize=TEXT_PT)
    lower.set_xticks(place + 0.2, [f"{width}" for width in WIDTHS], color=INK)
    lower.set_xlabel("columns of the range image")
    lower.tick_params(length=0)
    lower.legend(loc="upper right", fontsize=TEXT_PT - 1, labelcolor=INK, frameon=False)
    lower.set_ylim(0, 125)
    titled(lower, "share of the points of the scan")
    save(figure, picture)


def _rgb(colour: str) -> Values:
    """Return a colour such as #ff9d3b as red, green and blue from 0 to 1."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)]) / 255


def vote(data: Path, picture: Path) -> None:
    """Draw a detail before and after the vote of the neighbours."""
    shown = example(data)
    points = shown.scan.points
    changed = shown.labels != shown.before_vote
    # The detail shows where most labels of a car had leaked onto what lies behind it.
    leaked = changed & (shown.before_vote == CAR) & (shown.labels == shown.truth)
    cells, counts = np.unique(points[leaked][:, :2] // 4, axis=0, return_counts=True)
    across, up = (4 * cells[counts.argmax()] + 2).tolist()
    centre = (across, up + 2)
    reach = (8.0, 6.0)
    order = np.argsort(changed)
    figure = sheet(5.2)
    titles = {"class of the pixel": shown.before_vote, "after the vote": shown.labels}
    for axis, (title, labels) in zip(panels(figure, 1, 2), titles.items(), strict=True):
        faded = 0.4 * class_colours(labels) + 0.6 * np.array(DARK)
        colours = np.where(changed[:, None], class_colours(labels), faded)
        from_above(axis, points[order], colours[order], centre, reach, 20)
        titled(axis, title)
    inside = (abs(points[:, :2] - centre) < reach).all(axis=1)
    visible = np.concatenate([shown.before_vote[inside], shown.labels[inside]])
    legend(figure, legend_of(sn.label_space(), visible[visible > 0]), 5)
    save(figure, picture)


def uncertainties(data: Path, picture: Path) -> None:
    """Draw wrong labels and all uncertainties of the same points."""
    shown = example(data)
    points = shown.scan.points
    figure = sheet(15.6)
    axes = panels(figure, 8, 2, height_ratios=[13, 1] * 4)
    wrong = shown.wrong
    known = shown.truth > 0
    colours = np.select([wrong[:, None], known[:, None]], [RED, GREY], _rgb(FAINT))
    order = np.argsort(wrong)
    from_above(axes[0], points[order], colours[order], CENTRE_M, REACH_M, POINT)
    titled(axes[0], f"wrong labels ({wrong.sum() / known.sum():.0%})")
    outcomes = (("right", RIGHT), ("wrong", WRONG))
    for number, (name, colour) in enumerate(outcomes):
        axes[2].text(0.25 + 0.3 * number, 0.5, f"■ {name}", color=np.array(colour) / 255,
                     fontsize=TEXT_PT, transform=axes[2].transAxes, va="center")  # fmt: skip
    for number, (kind, (marks, title)) in enumerate(KINDS.items(), 1):
        row, column = divmod(number, 2)
        values = np.nan_to_num(shown.uncertainty[kind])
        order = np.argsort(values)
        shades = value_colours(values[order], *marks) / 255
        panel = axes[4 * row + column]
        from_above(panel, points[order], shades, CENTRE_M, REACH_M, POINT)
        titled(panel, title)
        colour_bar(axes[4 * row + 2 + column], marks)
    save(figure, picture)
