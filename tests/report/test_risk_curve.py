# SPDX-License-Identifier: MIT
import numpy as np
from matplotlib.axes import Axes

from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.report.risk_curve import risk_curve_picture


def test_the_picture_has_the_curve_the_limit_and_all_scans(monkeypatch):
    drawn = {}

    def noted(name):
        original = getattr(Axes, name)

        def note(self, *values, **style):
            drawn.setdefault(name, []).append([np.asarray(value).tolist() for value in values])
            return original(self, *values, **style)

        monkeypatch.setattr(Axes, name, note)

    for name in ("plot", "axhline", "scatter"):
        noted(name)
    threshold = RiskThreshold(
        kind="error", threshold=0.2, at_most=0.1, confidence=None, scans=2, sequences=("08",)
    )
    accepted, wrong = np.array([0, 0.5, 1]), np.array([0, 0.05, 0.25])
    scans, held_out = np.array([[0.5, 0.04], [0.6, 0.06]]), np.array([[0.4, 0.12]])
    png = risk_curve_picture(threshold, accepted, wrong, scans, held_out)
    assert png.startswith(b"\x89PNG")
    assert drawn["plot"] == [[[0, 50, 100], [0, 5, 25]]]
    assert drawn["axhline"] == [[10]]
    assert np.allclose(drawn["scatter"][0], [[50, 60], [4, 6]])
    assert np.allclose(drawn["scatter"][1], [[40], [12]])
    assert risk_curve_picture(threshold, accepted, wrong, scans, np.zeros((0, 2))) != png
