# SPDX-License-Identifier: MIT
"""Kinds of uncertainty that stages write, in the order of lists."""

from typing import NamedTuple

BLUE, SKY, ORANGE, RED, GREEN = "#0072b2", "#56b4e9", "#e69f00", "#d55e00", "#009e73"
PURPLE = "#cc79a7"
"""Colours that colour-blind people can distinguish."""
PREDICT = "run `salsanext predict {scans} {out}` first"
UNCERTAINTY_STAGE = "run `salsanext uncertainty {scans} {out}` first"
FUSE = "run `salsanext fuse {out}` first"
PREDICT_ERROR = (
    "run `salsanext predict {scans} {out} --error` with the default weights "
    "or weights of `salsanext tune error`"
)


class UncertaintyKind(NamedTuple):
    """Kind of uncertainty of points, in the folder `uncertainty/<kind>`."""

    title: str  # Title of pictures
    made_by: str  # Hint for an output folder `out` of `scans` without it
    colour: str  # Colour of its line in plots
    is_dashed: bool = False
    unit: str = ""
    most: float = float("inf")


UNCERTAINTY = {
    "error": UncertaintyKind(
        "error: probability that the label is wrong", PREDICT_ERROR, PURPLE, most=1.0
    ),
    "epistemic": UncertaintyKind("epistemic uncertainty", UNCERTAINTY_STAGE, BLUE),
    "aleatoric": UncertaintyKind("aleatoric uncertainty", UNCERTAINTY_STAGE, ORANGE),
    "total": UncertaintyKind("total uncertainty", UNCERTAINTY_STAGE, RED),
    "entropy": UncertaintyKind(
        "uncertainty: entropy of the classes", UNCERTAINTY_STAGE, GREEN, unit="nats"
    ),
    "mutual_information": UncertaintyKind(
        "uncertainty: mutual information", UNCERTAINTY_STAGE, BLUE, is_dashed=True, unit="nats"
    ),
    "least_confidence": UncertaintyKind(
        "uncertainty: 1 − the largest probability", PREDICT, SKY, most=1.0
    ),
    "disagreement": UncertaintyKind(
        "disagreement: share of the scans against the label", FUSE, PURPLE, is_dashed=True, most=1.0
    ),
}
MEANT_BY_UNCERTAINTY = ("entropy", "disagreement", "least_confidence")
"""Kinds that "uncertainty" stands for without the error; the first available one counts."""
COLOUR_HELP = (
    "label, truth, wrong, intensity, range, uncertainty, or one kind of it: "
    f"{', '.join(UNCERTAINTY)}"
)
