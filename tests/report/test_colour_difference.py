# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.report.colour_difference import colour_difference, lab_difference, lab_of

PUBLISHED = """
50 2.6772 -79.7751 50 0 -82.7485 2.0425
50 -1.3802 -84.2814 50 0 -82.7485 1.0000
50 0 0 50 -1 2 2.3669
50 2.49 -0.001 50 -2.49 0.0009 7.1792
50 2.49 -0.001 50 -2.49 0.0011 7.2195
50 -0.001 2.49 50 0.0009 -2.49 4.8045
50 2.5 0 50 0 -2.5 4.3065
50 2.5 0 73 25 -18 27.1492
50 2.5 0 61 -5 29 22.8977
50 2.5 0 56 -27 -3 31.9030
50 2.5 0 58 24 15 19.4535
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""
"""Pairs of CIELAB colours and their difference, of the table in the paper by Sharma and others."""


@pytest.mark.parametrize("line", PUBLISHED.split("\n")[1:-1])
def test_differences_are_those_published(line):
    *values, expected = map(float, line.split())
    first, second = np.array(values[:3]), np.array(values[3:])
    assert lab_difference(first, second) == pytest.approx(expected, abs=5e-5)
    assert lab_difference(second, first) == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize(
    ("rgb", "lab"),
    [
        ((255, 255, 255), (100, 0, 0)),
        ((0, 0, 0), (0, 0, 0)),
        ((255, 0, 0), (53.24, 80.09, 67.20)),
        ((0, 255, 0), (87.73, -86.18, 83.18)),
        ((0, 0, 255), (32.30, 79.19, -107.86)),
        ((119, 119, 119), (50.03, 0, 0)),
    ],
    ids=str,
)
def test_lab_of_known_colours(rgb, lab):
    np.testing.assert_allclose(lab_of(np.array(rgb)), lab, atol=0.01)


def test_colours_are_broadcast():
    colours = np.array([[0, 0, 0], [255, 255, 255]], np.uint8)
    found = colour_difference(colours[:, None], colours[None])
    np.testing.assert_allclose(found, [[0, 100], [100, 0]], atol=1e-3)
