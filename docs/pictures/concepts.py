# SPDX-License-Identifier: MIT
"""Draw the pictures of the concepts from one scan of the drive that training has not seen."""

from __future__ import annotations

import tempfile
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from labelled_drives import linked_semantickitti
from measurements import percent, salsanext
from prepared import predicted_drive

import salsanext_cli as sn
from pictures.rendering import BACKGROUND, ERROR_MARKS
from pictures.shrink import shrink

mpl.use("Agg")

from matplotlib.figure import Figure

SCAN = "000059"
"""First scan of the drive."""
TRUTH = "pandaset/sequences/002/labels"
DARK = np.array(BACKGROUND) / 255
INK, GREY, ORANGE, RED, GREEN = "#e6e6e6", "#5b616b", "#ff9d3b", "#ff4830", "#3fbf6f"
WIDTHS = (256, 512, 1024, 2048)
REACH_M = 32.0
FAR_M = 1.0
"""Distance behind the nearest point of a pixel from which another surface is likely."""
CAR = 1
WIDTH_PX, DOTS = 1400, 160

Values = npt.NDArray[Any]


class Example(NamedTuple):
    """A scan with its labels and uncertainties."""

    scan: sn.Scan
    network: sn.Network
    image: sn.RangeImage
    pixel_labels: Values  # (H, W) train ids
    labels: Values  # (N,) uint8, train ids, after the vote
    truth: Values  # (N,) train ids; 0 where it is not known
    uncertainty: dict[str, Values]  # (N,) float32 by kind

    @property
    def before_vote(self) -> Values:
        """Label of the pixel of each point, (N,) train ids."""
        pixels = self.image.pixel_of_point
        return np.where(pixels >= 0, self.pixel_labels.ravel()[pixels], 0)


@cache
def example(data: Path) -> Example:
    """Predict the drive and return one scan of it."""
    space = sn.label_space()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _, results = predicted_drive(data, folder, "--error")
        salsanext("uncertainty", folder / "drive", folder / "out", "--limit", 1)
        kinds = {
            kind.name: np.load(kind / f"{SCAN}.npy") for kind in (results / "uncertainty").iterdir()
        }
        scan = sn.read_scan(folder / "drive" / f"{SCAN}.bin")
        network = sn.fit_network(sn.load_network(), folder / "drive")
    image = sn.project(scan, network.sensor)
    pixel_labels = network.probabilities(image).argmax(axis=0)
    labels = sn.knn_refine(image, pixel_labels)
    truth = space.to_train(sn.read_labels(data / TRUTH / f"{SCAN}.label"))
    return Example(scan, network, image, pixel_labels, labels, truth, kinds)


def behind(image: sn.RangeImage) -> Values:
    """Return how far each point lies behind the nearest one of its pixel, in metres, (N,)."""
    pixels = image.pixel_of_point
    nearest = image.channels[0].ravel()[pixels]
    return np.where(pixels >= 0, image.point_range - nearest, 0)


def hidden_shares(data: Path, width: int) -> tuple[float, float]:
    """Return the shares of points that share a pixel, and that lie far behind, at a width."""
    shown = example(data)
    sensor = shown.network.sensor
    image = sn.project(shown.scan, sensor.resized(sensor.height, width))
    pixels = image.pixel_of_point
    points = (pixels >= 0).sum()
    occupied = (image.point_of_pixel >= 0).sum()
    return 1 - occupied / points, (behind(image) > FAR_M).sum() / points


def measured(data: Path) -> dict[str, str]:
    """Return the figures of the captions."""
    shown = example(data)
    known = (shown.truth > 0) & (shown.labels > 0)
    changed = known & (shown.labels != shown.before_vote)
    return {
        **{f"shared_{width}": percent(hidden_shares(data, width)[0]) for width in WIDTHS},
        **{f"behind_{width}": percent(hidden_shares(data, width)[1]) for width in WIDTHS},
        "changed": percent(changed.sum() / known.sum()),
        "repaired": percent((shown.labels == shown.truth)[changed].mean()),
        "broken": percent((shown.before_vote == shown.truth)[changed].mean()),
    }


def class_colours(labels: Values) -> Values:
    """Return the colours of train ids, (…) to (…, 3), 0 to 1."""
    return np.where(labels[..., None] > 0, sn.label_space().colours[labels] / 255, DARK)


def sheet(rows: int, columns: int, height: float) -> tuple[Figure, list[Any]]:
    """Return a dark figure and its axes, without ticks."""
    figure = Figure(figsize=(WIDTH_PX / DOTS, height), facecolor=DARK, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes:
        axis.set_facecolor(DARK)
        axis.set_xticks([])
        axis.set_yticks([])
        axis.spines[:].set_visible(False)
        axis.title.set_color(INK)
        axis.title.set_fontsize(9)
    return figure, axes


def save(figure: Figure, picture: Path) -> None:
    """Write a figure as WebP."""
    png = BytesIO()
    figure.savefig(png, format="png", dpi=DOTS)
    png.seek(0)
    shrink(png, picture, WIDTH_PX)


def from_above(
    axis: Any, points: Values, colours: Any, title: str, centre: tuple[float, float] = (0, 0),
    reach: float = REACH_M, size: float = 0.6, **options: Any,
) -> None:  # fmt: skip
    """Draw points from above, x to the right."""
    x, y = points[:, 0] - centre[0], points[:, 1] - centre[1]
    near = (abs(x) < reach) & (abs(y) < reach / 1.3)
    axis.scatter(x[near], y[near], s=size, c=colours[near], linewidths=0, **options)
    axis.set_aspect("equal")
    axis.set_xlim(-reach, reach)
    axis.set_ylim(-reach / 1.3, reach / 1.3)
    axis.set_title(title)


def range_images(data: Path, picture: Path) -> None:
    """Draw range, intensity and labels of the range image."""
    shown = example(data)
    figure, axes = sheet(3, 1, 4.2)
    full = shown.image.channels[0] > 0
    distance = np.log(np.clip(shown.image.channels[0], 2, 80))
    intensity = np.clip(shown.image.channels[4], 0, np.quantile(shown.image.channels[4], 0.97))
    strips = {
        "range, bright is near": np.where(full, -distance, np.nan),
        "intensity": np.where(full, np.sqrt(intensity), np.nan),
        "predicted labels": class_colours(np.where(full, shown.pixel_labels, 0)),
    }
    for axis, (title, strip) in zip(axes, strips.items(), strict=True):
        axis.imshow(strip, cmap="bone", aspect="auto", interpolation="nearest")
        axis.set_title(title)
    save(figure, picture)


def hidden_points(data: Path, picture: Path) -> None:
    """Draw where points share a pixel, and how many do by the width of the image."""
    shown = example(data)
    figure, (left, right) = sheet(1, 2, 3.6)
    far = behind(shown.image) > FAR_M
    order = np.argsort(far)
    colours = np.where(far, ORANGE, GREY)[order]
    from_above(left, shown.scan.points[order], colours, f"orange: over {FAR_M:g} m behind", size=1)
    shares = 100 * np.array([hidden_shares(data, width) for width in WIDTHS])
    place = np.arange(len(WIDTHS))
    names = ("share a pixel with a nearer point", f"lie over {FAR_M:g} m behind it")
    for number, (name, colour) in enumerate(zip(names, (GREY, ORANGE), strict=True)):
        bars = right.bar(place + 0.4 * number, shares[:, number], 0.38, color=colour, label=name)
        right.bar_label(bars, [f"{s:.0f} %" for s in shares[:, number]], color=INK, fontsize=8)
    right.set_xticks(place + 0.2, [f"{width} columns" for width in WIDTHS], color=INK)
    right.tick_params(labelsize=8, length=0)
    right.legend(loc="upper right", fontsize=8, labelcolor=INK, frameon=False)
    right.set_ylim(0, 115)
    right.set_title("share of the points")
    save(figure, picture)


def vote(data: Path, picture: Path) -> None:
    """Draw a detail before and after the vote of the neighbours."""
    shown = example(data)
    points, changed = shown.scan.points, shown.labels != shown.before_vote
    # The detail shows where most labels of a car had leaked onto what lies behind it.
    leaked = changed & (shown.before_vote == CAR) & (shown.labels == shown.truth)
    cells, counts = np.unique(points[leaked][:, :2] // 4, axis=0, return_counts=True)
    centre = tuple(4 * cells[counts.argmax()] + 2)
    order = np.argsort(changed)
    figure, axes = sheet(1, 2, 3.6)
    titles = {"label of the pixel": shown.before_vote, "after the vote": shown.labels}
    for axis, (title, labels) in zip(axes, titles.items(), strict=True):
        faded = 0.4 * class_colours(labels) + 0.6 * DARK
        colours = np.where(changed[:, None], class_colours(labels), faded)
        from_above(axis, points[order], colours[order], title, centre, 8.0, 6.0)
    save(figure, picture)


def uncertainties(data: Path, picture: Path) -> None:
    """Draw wrong labels and five uncertainties of the same points."""
    shown = example(data)
    points, known = shown.scan.points, shown.truth > 0
    figure, axes = sheet(2, 3, 5.4)
    wrong = known & (shown.labels != shown.truth)
    colours = np.select([wrong, known], [RED, GREY], "#2b2e36")
    order = np.argsort(wrong)
    title = f"wrong labels: red ({wrong.sum() / known.sum():.0%})"
    from_above(axes[0], points[order], colours[order], title)
    kinds = ("error", "least_confidence", "epistemic", "aleatoric", "mutual_information")
    for axis, kind in zip(axes[1:], kinds, strict=True):
        values = np.nan_to_num(shown.uncertainty[kind])
        if kind == "error":
            values = np.interp(values, ERROR_MARKS, np.linspace(0, 1, len(ERROR_MARKS)))
        else:
            values = np.clip(values / np.quantile(values, 0.98), 0, 1)
        order = np.argsort(values)
        shades = mpl.colormaps["inferno"](0.2 + 0.8 * values[order])
        from_above(axis, points[order], shades, kind.replace("_", " "))
    save(figure, picture)


def guarantee(data: Path, picture: Path) -> None:
    """Draw the share of accepted wrong points of each scan over the threshold, and the limit."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, root = Path(temporary), Path(temporary, "semantickitti")
        linked_semantickitti(data, root)
        salsanext("predict", root, folder / "out", "--error")
        space, losses = sn.label_space(), []
        thresholds = np.linspace(0, 1, 101)
        for path in sorted((folder / "out").glob("sequences/*/predictions/*.label")):
            name, sequence = path.stem, path.parts[-3]
            truth = space.to_train(
                sn.read_labels(root / "sequences" / sequence / "labels" / f"{name}.label")
            )
            wrong = (truth > 0) & (space.to_train(sn.read_labels(path)) != truth)
            error = np.load(path.parents[1] / "uncertainty/error" / f"{name}.npy")
            losses.append(
                [(wrong & (error <= limit)).sum() / (truth > 0).sum() for limit in thresholds]
            )
    figure, (axis,) = sheet(1, 1, 3.6)
    loss, count = 100 * np.array(losses), len(losses)
    axis.plot(thresholds, loss.T, color=GREY, linewidth=0.8)
    axis.plot(thresholds, loss.mean(axis=0), color=INK, linewidth=2.2)
    limit = (10 * (count + 1) - 100) / count
    chosen = thresholds[loss.mean(axis=0) <= limit].max()
    axis.axhline(limit, color=ORANGE, linestyle="--", linewidth=1.2)
    axis.axvline(chosen, color=GREEN, linewidth=1.2)
    text = {"fontsize": 8, "transform": axis.get_yaxis_transform(), "va": "bottom"}
    axis.text(0.99, limit, "10 %, less the reserve for the next scan", color=ORANGE, ha="right",
              **text)  # fmt: skip
    axis.text(chosen + 0.01, 24, f"threshold {chosen:.2f}", color=GREEN, fontsize=8)
    axis.tick_params(colors=INK, labelsize=8)
    axis.set_xticks(np.linspace(0, 1, 6))
    axis.set_yticks(range(0, 31, 5))
    axis.set_xlabel("threshold of the error", color=INK, fontsize=8)
    axis.set_ylabel("accepted and wrong, % of all points", color=INK, fontsize=8)
    axis.set_title("27 scans of SemanticKITTI and their mean", fontsize=9)
    save(figure, picture)
