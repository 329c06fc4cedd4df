# SPDX-License-Identifier: MIT
"""Checks of the labels of a scan: the share of a class, and the confidence."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import MAX_COARSE_CLASSES, LabelSpace
from salsanext_cli.core.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.core.texts import percentage

MAX_SHARE = 0.75  # Largest credible share of a class in a scan; an empty crossroads had 0.6
MAX_SHARE_OF_FEW = 0.85
"""The same for few classes, as in `coarse`; right settings gave at most 0.67."""
MIN_CLASSES = 5
"""One of fewer classes may cover a whole scan. Both numbers include the class "unlabelled"."""
MIN_CONFIDENCE = 0.575  # Least usual mean of a scan; cities had 0.62 or more
MIN_CONFIDENCE_OF_FEW = 0.74  # The same for few classes; cities had 0.79 or more in `coarse`
SETTINGS_HINT = "check the sensor and its settings"
LABELS_HINT = "look at the labels"
"""End of the hints about labels, after which a run names the command."""


def label_findings(
    points: npt.NDArray[np.int64], confidence: float, space: LabelSpace
) -> Iterator[Finding]:
    """Yield reasons to doubt the labels of a scan.

    Parameters
    ----------
    points : (C,) int64
        Number of points by predicted train id.
    confidence : float
        Mean of the largest probabilities of the pixels, 0…1.
    space : LabelSpace
        Classes of the labels.

    Yields
    ------
    Finding
    """
    has_few = space.class_count <= MAX_COARSE_CLASSES
    if space.class_count >= MIN_CLASSES:
        total = int(points[1:].sum())
        largest = int(points[1:].argmax()) + 1
        most = MAX_SHARE_OF_FEW if has_few else MAX_SHARE
        if total >= MIN_TRAIT_POINTS and points[largest] > most * total:
            share = (
                f"{percentage(points[largest] / total, 0)} of the points are {space.names[largest]}"
            )
            yield Finding(WarningCode.ONE_CLASS, share, LABELS_HINT)
    if confidence < (MIN_CONFIDENCE_OF_FEW if has_few else MIN_CONFIDENCE):
        mean = f"the labels have a mean probability of {confidence:.2f}"
        yield Finding(WarningCode.LOW_CONFIDENCE, mean, f"{SETTINGS_HINT}; {LABELS_HINT}")
