# SPDX-License-Identifier: MIT
"""Pictures and the page of a training show its numbers."""

import io
from html.parser import HTMLParser

import numpy as np
import pytest
from calls import calls_of
from class_colours import CAR, ROAD, SPACE
from matplotlib.axes import Axes
from matplotlib.image import imread

from salsanext_cli.report import scan_pictures
from salsanext_cli.report.colours import EMPTY, RIGHT, WRONG, screen_colours
from salsanext_cli.report.training_pictures import (
    CURVE_PX,
    SampleLabels,
    curve_picture,
    samples_picture,
    training_page,
)

ROWS = [
    {"epoch": 1, "loss": 2.0, "miou": float("nan"), "accuracy": 0.5},
    {"epoch": 2, "loss": 1.0},
    {"epoch": 3, "loss": 0.5, "miou": 0.25, "accuracy": 0.75},
    {"epoch": 4, "loss": 0.25, "miou": 0.2, "accuracy": 0.8},
]


def test_the_curve_has_the_measured_epochs(monkeypatch):
    drawn = []
    plot = Axes.plot
    monkeypatch.setattr(
        Axes, "plot", lambda self, x, y, *a, **k: (drawn.append((x, y)), plot(self, x, y, *a, **k))
    )
    png = curve_picture(ROWS)
    assert drawn == [
        ([1, 2, 3, 4], [2.0, 1.0, 0.5, 0.25]),
        ([1, 3, 4], [50.0, 75.0, 80.0]),
        ([3, 4], [25.0, 20.0]),
        (3, 25.0),  # The best
    ]
    assert imread(io.BytesIO(png)).shape[1::-1] == CURVE_PX


def test_a_training_without_validation_has_a_curve():
    assert curve_picture([{"epoch": 1, "loss": 3.0}]).startswith(b"\x89PNG")


@pytest.fixture
def sample():
    """Return labels of which three quarters of the judged pixels are right."""
    truth = np.full((4, 8), CAR, np.uint8)
    predicted = truth.copy()
    predicted[:, 6:] = ROAD
    occupied = np.ones((4, 8), bool)
    occupied[0] = False
    truth[1] = 0
    return SampleLabels(name="08/000000", truth=truth, predicted=predicted, occupied=occupied)


def test_samples_have_truth_prediction_and_errors(sample):
    with calls_of(scan_pictures.scan_picture) as calls:
        samples_picture([sample, sample], SPACE, "after epoch 1")
    (call,) = calls
    strips = call["strips"]
    assert len(strips) == 6
    truth, predicted, errors = (strip.picture for strip in strips[:3])
    colours = screen_colours(SPACE)
    for y in range(4):
        for x in range(8):
            empty = y == 0
            expected = [EMPTY if empty else tuple(colours[0 if y == 1 else CAR])]
            expected += [EMPTY if empty else tuple(colours[ROAD if x >= 6 else CAR])]
            expected += [EMPTY if y < 2 else WRONG if x >= 6 else RIGHT]
            assert [tuple(p[y, x]) for p in (truth, predicted, errors)] == expected
    assert "75.0 %" in strips[2].title


class Images(HTMLParser):
    def __init__(self):
        super().__init__()
        self.sources, self.reloads = [], False

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag == "img":
            self.sources.append(attributes["src"])
        self.reloads |= attributes.get("http-equiv") == "refresh"


@pytest.mark.parametrize("is_running", [True, False])
def test_the_page_shows_the_pictures_until_the_end(is_running):
    pictures = {"curve.png": "a <curve>", "samples.png": "samples"}
    page = training_page("runs/<b>", "epoch 1", pictures, is_running=is_running).decode()
    images = Images()
    images.feed(page)
    assert (images.sources, images.reloads) == ([*pictures], is_running)
    assert "<b>" not in page
