# SPDX-License-Identifier: MIT
"""Draw how a threshold of risk is chosen: accepted wrong points of each scan, and the limit."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from labelled_drives import linked_semantickitti
from measurements import salsanext

import salsanext_cli as sn
from pictures.sheets import GREEN, GREY, INK, ORANGE, TEXT_PT, panels, save, sheet, titled

LIMIT = 10.0
"""Limit on the mean share of accepted wrong points, in %."""
THRESHOLDS = np.linspace(0, 1, 1001)


def draw(data: Path, picture: Path) -> None:
    """Draw the share of accepted wrong points of each scan over the threshold, and the limit."""
    losses = losses_of_scans(data)
    count = len(losses)
    mean = losses.mean(axis=0)
    limit = ((count + 1) * LIMIT - 100) / count
    chosen = THRESHOLDS[mean <= limit].max()
    figure = sheet(6.2)
    (axis,) = panels(figure, 1, 1)
    axis.plot(THRESHOLDS, losses.T, color=GREY, linewidth=1.2)
    axis.plot(THRESHOLDS, mean, color=INK, linewidth=4)
    axis.axhline(limit, color=ORANGE, linestyle="--", linewidth=2.5)
    axis.axvline(chosen, color=GREEN, linewidth=2.5)
    texts: dict[str, Any] = {"fontsize": TEXT_PT, "va": "bottom"}
    axis.text(1, limit, f"limit for the mean: {limit:.1f} %", color=ORANGE, ha="right", **texts)
    top = losses.max()
    axis.text(chosen + 0.01, 0.9 * top, f"threshold {chosen:.2f}", color=GREEN, **texts)
    axis.set_xticks(np.linspace(0, 1, 6))
    axis.set_yticks(range(0, round(top) + 1, 10))
    axis.set_xlabel("threshold of the error")
    axis.set_ylabel("accepted and wrong, %")
    titled(axis, f"{count} scans of SemanticKITTI (grey), and their mean (white)")
    save(figure, picture)


def losses_of_scans(data: Path) -> npt.NDArray[np.floating]:
    """Return the accepted wrong points in % of all points, (scans, thresholds)."""
    space = sn.label_space()
    losses = []
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary, "semantickitti")
        out = Path(temporary, "out")
        linked_semantickitti(data, root)
        salsanext("predict", root, out, "--error")
        for path in sorted(out.glob("sequences/*/predictions/*.label")):
            sequence = path.parts[-3]
            truth_file = root / "sequences" / sequence / "labels" / path.name
            truth = space.to_train(sn.read_labels(truth_file))
            labels = space.to_train(sn.read_labels(path))
            error = np.load(path.parents[1] / "uncertainty/error" / f"{path.stem}.npy")
            errors_of_wrong = np.sort(error[(truth > 0) & (labels != truth)])
            accepted = np.searchsorted(errors_of_wrong, THRESHOLDS, side="right")
            losses.append(100 * accepted / (truth > 0).sum())
    return np.array(losses)
