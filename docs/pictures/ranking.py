# SPDX-License-Identifier: MIT
"""Draw how well each kind of uncertainty ranks the labels of SemanticKITTI, and measure it."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from labelled_drives import linked_semantickitti
from measurements import percent, salsanext

from pictures.sheets import INK, TEXT_PT, panels, save, sheet, titled

COVERAGE = np.arange(1, 101)
"""Shares of the points that are accepted, in %, the least uncertain ones."""
LINES = {
    "error": ("#ff4830", "-"),
    "least_confidence": ("#ffffff", "-"),
    "entropy": ("#ffffff", ":"),
    "epistemic": ("#53a2ff", "-"),
    "mutual_information": ("#53a2ff", ":"),
    "aleatoric": ("#ffc800", "-"),
    "total": ("#3fbf6f", "-"),
}
"""Colour and dashes of each kind."""


@cache
def kinds(data: Path) -> dict[str, Any]:
    """Return what `eval` writes about each kind of uncertainty of 27 scans of SemanticKITTI."""
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary, "semantickitti")
        out = Path(temporary, "out")
        linked_semantickitti(data, root)
        salsanext("predict", root, out, "--error")
        salsanext("uncertainty", root, out)
        salsanext("eval", out)
        evaluation = json.loads((out / "eval.json").read_text("utf-8"))
    uncertainty: dict[str, Any] = evaluation["uncertainty"]
    return {kind: uncertainty[kind] for kind in LINES}


def measured(data: Path) -> dict[str, str]:
    """Return AUROC, AURC and the risk at a coverage of 80 %, of each kind."""
    values = {}
    for kind, scores in kinds(data).items():
        values[f"auroc_{kind}"] = percent(scores["auroc"])
        values[f"aurc_{kind}"] = percent(scores["aurc"])
        values[f"risk_{kind}"] = percent(scores["risk_coverage"][79])
    return values


def draw(data: Path, picture: Path) -> None:
    """Draw the share of wrong points among the accepted ones, over the share of accepted ones."""
    figure = sheet(8)
    (axis,) = panels(figure, 1, 1)
    for kind, scores in kinds(data).items():
        colour, dashes = LINES[kind]
        label = f"{kind.replace('_', ' ')} {percent(scores['aurc'])}"
        risk = 100 * np.array(scores["risk_coverage"])
        axis.plot(COVERAGE, risk, color=colour, linestyle=dashes, linewidth=2.5, label=label)
    axis.set_xlim(0, 100)
    axis.set_ylim(bottom=0)
    axis.set_xticks(range(0, 101, 20))
    axis.set_yticks(range(0, round(axis.get_ylim()[1]) + 1, 5))
    axis.grid(color=INK, alpha=0.15)
    axis.set_xlabel("accepted: the least uncertain points, %")
    axis.set_ylabel("wrong among them, %")
    titled(axis, "SemanticKITTI, 27 scans; numbers: AURC in %")
    box = figure.legend(
        loc="outside lower center", ncols=2, fontsize=TEXT_PT - 1, frameon=False, handlelength=1.6
    )
    for text in box.get_texts():
        text.set_color(INK)
    save(figure, picture)
