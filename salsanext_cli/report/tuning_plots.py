# SPDX-License-Identifier: MIT
"""Plot of the threshold of `tune risk`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK

CHOSEN = "#b3472f"
DASHES = (0, (4, 3))
SIZE, PLACE = (760, 460), (90, 50, 640, 340)


def risk_curve(report: Mapping[str, Any]) -> bytes:
    """Draw wrong against accepted points, from a report of `tune risk`, as a PNG."""
    level, held_out = 100 * report["at_most"], report["left_out"]
    title = f"accepted: {report['kind']} up to {report['threshold']:.3g}"
    title += f" · at most {level:.3g} % wrong"
    figure, axes = canvas.new_plot(*SIZE, PLACE, title)
    accepted, wrong = 100 * np.array(report["risk_coverage"])
    axes.plot(accepted, wrong, color=DARK, label="all thresholds, mean of scans")
    axes.axhline(level, color=CHOSEN, linewidth=1, linestyle=DASHES, label="level")
    scans = 100 * np.array(report["of_scans"])
    cross: dict[str, Any] = {"marker": "x", "linewidths": 1, "label": "scan at the threshold"}
    axes.scatter(scans[:, 0], scans[:, 1], s=22, c=DARK, **cross)
    worst = 100 * np.array(
        [(sequence["accepted"], sequence["worst"]) for sequence in held_out]
    ).reshape(-1, 2)
    label = "worst scan of a held-out sequence"
    axes.scatter(worst[:, 0], worst[:, 1], s=46, facecolors="none", edgecolors=CHOSEN, label=label)
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 1.1 * max(2 * level, *scans[:, 1], *worst[:, 1]))
    axes.set_xlabel("coverage: accepted points, in %")
    axes.set_ylabel("accepted and wrong, in % of all points")
    axes.legend(loc="upper left", frameon=False, fontsize=10)
    canvas.plain_frame(axes)
    return canvas.png_of(figure)
