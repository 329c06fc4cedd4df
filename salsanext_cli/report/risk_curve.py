# SPDX-License-Identifier: MIT
"""Picture of the threshold of `tune risk`: accepted and wrong points at every threshold."""

from __future__ import annotations

from typing import Any

import numpy as np

from salsanext_cli.core.measures.scores import Ratios
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.texts import percentage
from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.plots import BLUE, DASHED, RED

SIZE_PX = 800, 540
PLACE_PX = 80, 60, 680, 400  # Left, top, width and height of the axes


def risk_curve_picture(
    threshold: RiskThreshold, accepted: Ratios, wrong: Ratios, scans: Ratios, held_out: Ratios
) -> bytes:
    """Draw the share of accepted and wrong points against that of accepted points, as a PNG.

    Parameters
    ----------
    threshold : RiskThreshold
        Chosen threshold and its limit.
    accepted : (T,) float64
        Share of the points that each threshold accepts, 0…1, mean over scans.
    wrong : (T,) float64
        Share of the points that each threshold accepts and that are wrong.
    scans : (n, 2) float64
        The same two shares of each scan at the chosen threshold.
    held_out : (m, 2) float64
        The same two shares of each sequence at the threshold of the other sequences.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    name = threshold.kind.replace("_", " ")
    title = f"Threshold: {name} up to {threshold.threshold:.3g} is accepted"
    figure, axes = canvas.new_plot(*SIZE_PX, PLACE_PX, title)
    axes.plot(100 * accepted, 100 * wrong, color=BLUE, label="all thresholds, mean over scans")
    limit = f"limit of {percentage(threshold.at_most, figures=3)}"
    axes.axhline(100 * threshold.at_most, color=RED, linewidth=1.2, linestyle=DASHED, label=limit)
    crosses: dict[str, Any] = {"marker": "x", "linewidths": 1.2, "color": DARK}
    axes.scatter(
        100 * scans[:, 0],
        100 * scans[:, 1],
        s=26,
        label="each scan at the chosen threshold",
        **crosses,
    )
    if len(held_out):
        rings: dict[str, Any] = {"facecolors": "none", "edgecolors": RED, "linewidths": 1.4}
        label = "each sequence at the threshold of the others"
        axes.scatter(100 * held_out[:, 0], 100 * held_out[:, 1], s=60, label=label, **rings)
    highest = max(2 * threshold.at_most, *scans[:, 1], *held_out[:, 1])
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 110 * float(np.clip(highest, 1e-3, 1)))
    axes.set_xlabel("accepted points of known classes, in %")
    axes.set_ylabel("accepted and wrong, in % of all points of known classes")
    axes.legend(loc="upper left", frameon=False, fontsize=10)
    canvas.plain_frame(axes)
    return canvas.png_of(figure)
