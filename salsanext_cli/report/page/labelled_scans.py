# SPDX-License-Identifier: MIT
"""Comparison of the labels of a run with those of the data set, as a page shows it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.report.page.confusions import (
    ConfusionMatrix,
    confusion_matrix,
    largest_confusions_in_words,
)
from salsanext_cli.report.page.run_results import Comparison
from salsanext_cli.report.plots import PICTURES, iou_picture, uncertainty_pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A plot."""

    description: str
    address: str  # As `img` takes it


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledScans:
    """Comparison of the labels of a run with those of the data set."""

    matrix: ConfusionMatrix | None  # None without labelled points
    confusions: Sequence[str]  # The largest ones, in words
    figures: Sequence[Figure]


def labelled_scans(compared: Comparison, space: LabelSpace) -> LabelledScans | None:
    """Return the section on labelled scans; None if it is empty."""
    confusion = compared.counts.confusion
    pictures = uncertainty_pictures(compared.uncertainty)
    if compared.scores.points:
        pictures = {"eval_iou.png": iou_picture(compared.scores, space), **pictures}
    figures = [
        Figure(
            description=PICTURES[name],
            address=f"data:image/png;base64,{b64encode(png).decode('ascii')}",
        )
        for name, png in pictures.items()
    ]
    section = LabelledScans(
        matrix=confusion_matrix(confusion, space),
        confusions=largest_confusions_in_words(confusion, space),
        figures=figures,
    )
    return section if section.matrix or section.confusions or section.figures else None
