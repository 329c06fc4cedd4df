# SPDX-License-Identifier: MIT
from io import BytesIO

import numpy as np
import pytest
from evaluated import SPACE, calibration_result, ranking_result
from matplotlib.image import imread

from salsanext_cli.report.uncertainty_plots import (
    HEIGHT_ABOVE,
    LEFT,
    PLOT_PX,
    SKY,
    TOP,
    WIDTH,
    class_uncertainty,
    reliability_diagram,
    risk_coverage,
    sparsification,
)


def pixels(png: bytes) -> np.ndarray:
    return (imread(BytesIO(png))[:, :, :3] * 255).round().astype(int)


def rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def rows_of(picture, colour, x) -> np.ndarray:
    """Return how high a colour reaches in a column of the axes: 0 at the bottom, 1 at the top."""
    column = picture[TOP : TOP + HEIGHT_ABOVE + 1, LEFT + round(x * WIDTH)]
    near = np.abs(column - rgb(colour)).sum(axis=-1) < 60
    return 1 - np.flatnonzero(near) / HEIGHT_ABOVE


def test_bars_are_as_high_as_the_accuracy():
    picture = pixels(reliability_diagram(calibration_result([1] * 6 + [2] * 4)))
    assert rows_of(picture, SKY, 11.5 / 15).max() == pytest.approx(0.6, abs=0.01)
    assert not rows_of(picture, SKY, 5.5 / 15).size


@pytest.mark.parametrize("count", [0, 2])
def test_pictures_are_of_one_size_with_wrong_points_or_without(count):
    result = ranking_result([0.1] * count, np.zeros(count, bool))
    for picture in (
        risk_coverage({"epistemic": result}),
        sparsification({"epistemic": result}),
        class_uncertainty(result, SPACE),
        reliability_diagram(calibration_result([])),
    ):
        assert pixels(picture).shape[1::-1] == PLOT_PX
