# SPDX-License-Identifier: MIT
"""Plots of an evaluation."""

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import Scores
from salsanext_cli.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.report import plots, uncertainty_plots

PICTURES = {
    "eval_iou.png": "IoU of every class",
    "eval_confusion.png": "Confusion matrix",
    "eval_reliability.png": "Calibration of the softmax: accuracy against confidence",
    "eval_risk_coverage.png": "Wrong points among the least uncertain ones",
    "eval_sparsification.png": "Wrong points that are left as the most uncertain are removed",
    "eval_class_uncertainty.png": "Mean epistemic uncertainty of the classes",
}
"""All plots, by the name of the file, in words."""


def evaluation_pictures(
    scores: Scores, confusion: Confusion, uncertainty: UncertaintyEvaluation, space: LabelSpace
) -> dict[str, bytes]:
    """Draw what there is to an evaluation, PNG by name, in the order of `PICTURES`."""
    scored = {
        "eval_iou.png": plots.iou_bars(scores, space),
        "eval_confusion.png": plots.confusion_picture(confusion, space),
    }
    return scored | uncertainty_pictures(uncertainty, space)


def uncertainty_pictures(uncertainty: UncertaintyEvaluation, space: LabelSpace) -> dict[str, bytes]:
    """Draw what there is to probabilities and uncertainties, as `evaluation_pictures`."""
    pictures = {}
    if uncertainty.calibration:
        diagram = uncertainty_plots.reliability_diagram(uncertainty.calibration)
        pictures["eval_reliability.png"] = diagram
    if uncertainty.kinds:
        pictures["eval_risk_coverage.png"] = uncertainty_plots.risk_coverage(uncertainty.kinds)
        pictures["eval_sparsification.png"] = uncertainty_plots.sparsification(uncertainty.kinds)
    if epistemic := uncertainty.kinds.get("epistemic"):
        picture = uncertainty_plots.class_uncertainty(epistemic, space)
        pictures["eval_class_uncertainty.png"] = picture
    return pictures
