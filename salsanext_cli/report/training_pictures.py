# SPDX-License-Identifier: MIT
"""Pictures and page of a training that is running: its curve, and predictions of some scans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.records import Mask
from salsanext_cli.core.texts import percentage, printable
from salsanext_cli.report import canvas
from salsanext_cli.report.colours import EMPTY, RIGHT, WRONG, Colours, legend_of, screen_colours
from salsanext_cli.report.plots import BLUE, GREEN, ORANGE, RED
from salsanext_cli.report.scan_pictures import Strip, scan_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVE_PX = 960, 400  # Size of the picture of the curve
LOSS_PX = 70, 60, 380, 270  # Axes of the loss: left, top, width, height
SCORES_PX = 540, 60, 380, 270
RELOAD_S = 30  # Seconds after which the page of a running training is loaded again

Row = Mapping[str, float]
"""One epoch, as in the log of a training."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleLabels:
    """Labels of the pixels of one scan."""

    name: str  # Sequence and stem
    truth: TrainIds  # (H, W)
    predicted: TrainIds  # (H, W)
    occupied: Mask  # (H, W): whether a point is in the pixel


def curve_picture(rows: Sequence[Row]) -> bytes:
    """Draw the loss, and the scores of the validated epochs, over the epochs as a PNG.

    Parameters
    ----------
    rows : sequence of mapping
        Finished epochs, at least one, with ``epoch`` and ``loss``; where validated, also with
        ``miou`` and ``accuracy``, 0…1.
    """
    last = int(rows[-1]["epoch"])
    figure, loss = canvas.new_plot(*CURVE_PX, LOSS_PX, f"Training after epoch {last}")
    losses = _points_of(rows, "loss")
    loss.plot(*losses, color=BLUE, marker=".", linewidth=1.4)
    loss.set_ylabel("mean loss of the epoch")
    # With room for the marker of the highest value
    loss.set_ylim(0, 1.05 * max(losses[1], default=0) or 1)
    scores = canvas.axes_at(figure, *SCORES_PX)
    for key, name, colour in (("accuracy", "accuracy", ORANGE), ("miou", "mean IoU", GREEN)):
        epochs, shares = _points_of(rows, key)
        label = f"{name}, last {percentage(shares[-1])}" if shares else name
        percents = [100 * share for share in shares]
        scores.plot(epochs, percents, ".-", color=colour, label=label, clip_on=False)
    epochs, mious = _points_of(rows, "miou")
    if mious:
        best = int(np.argmax(mious))
        label = f"best mean IoU {percentage(mious[best])}, epoch {epochs[best]:.0f}"
        marker: dict[str, Any] = {"color": RED, "markersize": 8, "clip_on": False}
        scores.plot(epochs[best], 100 * mious[best], "o", label=label, **marker)
    else:
        canvas.text_at(figure, SCORES_PX[0] + 90, 190, "no validation yet", 15, canvas.FAINT)
    scores.set_ylabel("validation, points, in %")
    scores.set_ylim(0, 100)
    if mious:
        scores.legend(loc="best", frameon=False, fontsize=9)
    for axes in (loss, scores):
        _number_epochs(axes, last)
        canvas.plain_frame(axes)
    return canvas.png_of(figure)


def _points_of(rows: Sequence[Row], key: str) -> tuple[list[float], list[float]]:
    """Return the epochs with a value, and their values."""
    measured = [row for row in rows if key in row and math.isfinite(row[key])]
    return [row["epoch"] for row in measured], [row[key] for row in measured]


def _number_epochs(axes: Axes, last: int) -> None:
    """Label the axis of the epochs with whole numbers."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlim(0.5, max(last, 2) + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set_xlabel("epoch")


def samples_picture(samples: Sequence[SampleLabels], space: LabelSpace, heading: str) -> bytes:
    """Draw truth, prediction and errors of some scans as range images, as a PNG.

    Parameters
    ----------
    samples : sequence of SampleLabels
        Labels of the pixels.
    space : LabelSpace
        Their classes.
    heading : str
        First line.
    """
    strips: list[Strip] = []
    for sample in samples:
        right = _shares_right(sample, space)
        strips += [
            Strip(f"{printable(sample.name)}: truth", _class_colours(sample.truth, sample, space)),
            Strip("prediction", _class_colours(sample.predicted, sample, space)),
            Strip(f"errors: {right} of the pixels are right", _outcome_colours(sample, space)),
        ]
    shown = [labels[s.occupied] for s in samples for labels in (s.truth, s.predicted)]
    legend = [*legend_of(space, *shown), ("right", RIGHT), ("wrong", WRONG)] if shown else []
    return scan_picture(heading, np.zeros((0, 3), np.float32), {}, strips, legend)


def _class_colours(labels: TrainIds, sample: SampleLabels, space: LabelSpace) -> Colours:
    """Return the colours (H, W, 3) of the classes of pixels."""
    colours = screen_colours(space)[labels]
    return np.where(sample.occupied[..., None], colours, np.array(EMPTY, np.uint8))


def _outcome_colours(sample: SampleLabels, space: LabelSpace) -> Colours:
    """Return the colours (H, W, 3) of right and wrong pixels; others are empty."""
    is_right = (sample.truth == sample.predicted)[..., None]
    outcomes = np.where(is_right, np.array(RIGHT, np.uint8), np.array(WRONG, np.uint8))
    judged = (sample.occupied & space.scored[sample.truth])[..., None]
    return np.where(judged, outcomes, np.array(EMPTY, np.uint8))


def _shares_right(sample: SampleLabels, space: LabelSpace) -> str:
    """Return the share of the labelled pixels that are right, in words."""
    judged = sample.occupied & space.scored[sample.truth]
    if not judged.any():
        return "none"
    return percentage(float((sample.truth == sample.predicted)[judged].mean()))


def training_page(
    title: str, state: str, pictures: Mapping[str, str], *, is_running: bool
) -> bytes:
    """Return a page that shows pictures beside it, and loads itself again while a training runs.

    Parameters
    ----------
    title : str
        Heading, such as the name of the run folder.
    state : str
        Line below the heading.
    pictures : mapping of str to str
        Descriptions by the name of the file.
    is_running : bool
        Whether the page loads itself again.
    """
    reload = f'<meta http-equiv="refresh" content="{RELOAD_S}">' if is_running else ""
    note = f"This page is loaded again every {RELOAD_S} seconds." if is_running else "Finished."
    images = "".join(
        f'<figure><img src="{escape(name)}" alt="{escape(text)}"></figure>\n'
        for name, text in pictures.items()
    )
    name = escape(printable(title))
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">{reload}
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name} · salsanext train</title>
<style>
body {{ margin: 0 auto; max-width: 1240px; padding: 0 16px 24px;
  background: #12131a; color: {canvas.INK}; font: 15px/1.5 system-ui, sans-serif; }}
h1 {{ font-size: 22px; overflow-wrap: anywhere; }}
figure {{ margin: 16px 0; overflow-x: auto; }}
img {{ max-width: 100%; min-width: 640px; display: block; border-radius: 6px; }}
</style></head><body>
<h1>{name}</h1>
<p>{escape(printable(state))}</p>
{images}<p>{note}</p>
</body></html>
""".encode()
