# SPDX-License-Identifier: MIT
import itertools

import numpy as np
import pytest
from matplotlib.image import imread

from salsanext_cli.classes import label_space
from salsanext_cli.measures.calibration import Calibration, judge
from salsanext_cli.measures.figures import calibration_figures, uncertainty_figures
from salsanext_cli.measures.ranking import Ranking
from salsanext_cli.measures.uncertainty_counts import KINDS
from salsanext_cli.report import canvas
from salsanext_cli.report.labels import name_dots
from salsanext_cli.report.uncertainty_plots import (
    BLUE,
    HEIGHT,
    LEFT,
    LINES,
    SKY,
    TOP,
    WIDTH,
    class_uncertainty,
    reliability_diagram,
    risk_coverage,
    sparsification,
)

SPACE = label_space()
C = SPACE.class_count


def pixels(path):
    return (imread(path)[:, :, :3] * 255).round().astype(int)


def rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def rows_of(picture, colour, x) -> np.ndarray:
    """Return how high a colour reaches in a column of the axes: 0 at the bottom, 1 at the top."""
    column = picture[TOP : TOP + HEIGHT + 1, LEFT + round(x * WIDTH)]
    near = np.abs(column - rgb(colour)).sum(axis=-1) < 60
    return 1 - np.flatnonzero(near) / HEIGHT


def ranked(uncertainty, wrong, truth):
    ranking = Ranking.none(C).update(np.asarray(uncertainty, np.float32), wrong, truth)
    return uncertainty_figures(ranking, None, SPACE)


def half_wrong(count=1000):
    """Uncertainty that says nothing: one in two is wrong, wherever one looks."""
    return ranked(np.full(count, 0.1), np.arange(count) % 2 == 1, np.ones(count, int))


def test_bars_are_as_high_as_the_accuracy(tmp_path):
    rows = np.tile(np.array([[0, 0.75, 0.25]], np.float16), (10, 1))
    judged = judge(rows, np.array([1] * 6 + [2] * 4))
    by_class = Calibration.none(C).update(judged, judged.predicted)
    reliability_diagram(tmp_path / "r.png", calibration_figures(by_class, None, SPACE))
    picture = pixels(tmp_path / "r.png")
    assert rows_of(picture, SKY, 11.5 / 15).max() == pytest.approx(0.6, abs=0.01)
    assert not rows_of(picture, SKY, 5.5 / 15).size


def test_the_risk_of_useless_uncertainty_is_flat(tmp_path):
    risk_coverage(tmp_path / "rc.png", {"epistemic": half_wrong()})
    sparsification(tmp_path / "sp.png", {"epistemic": half_wrong()})
    for name in ("rc.png", "sp.png"):
        picture = pixels(tmp_path / name)
        heights = [rows_of(picture, BLUE, x).mean() for x in (0.1, 0.5, 0.9)]
        assert max(heights) - min(heights) < 0.01
        assert min(heights) > 0.9


def test_the_dots_are_where_the_classes_are(tmp_path):
    car, road = SPACE.names.index("car"), SPACE.names.index("road")
    truth = np.repeat([car, road], [10, 1000])
    figures = ranked(np.where(truth == car, 0.2, 0.1), truth < 0, truth)
    class_uncertainty(tmp_path / "c.png", figures, SPACE)
    picture = pixels(tmp_path / "c.png")
    places = {}
    for i in (car, road):
        rows, columns = np.nonzero((picture == SPACE.colours[i]).all(axis=-1))
        places[i] = (rows.mean(), columns.mean())
    assert places[car][0] < places[road][0]
    assert places[car][1] < places[road][1]
    bottom = TOP + HEIGHT + 80
    heights = [bottom - places[i][0] for i in (car, road)]
    assert heights[0] / heights[1] == pytest.approx(2, abs=0.03)


def test_nothing_to_draw_is_drawn(tmp_path):
    nothing = ranked([], np.zeros(0, bool), np.zeros(0, int))
    right = ranked([0.1, 0.1], np.array([False, False]), np.array([1, 1]))
    for name, figures in {"nothing": nothing, "right": right}.items():
        risk_coverage(tmp_path / f"{name}-rc.png", {"epistemic": figures})
        sparsification(tmp_path / f"{name}-sp.png", {"epistemic": figures})
        class_uncertainty(tmp_path / f"{name}-c.png", figures, SPACE)
    empty = calibration_figures(Calibration.none(C), None, SPACE)
    reliability_diagram(tmp_path / "r.png", empty)
    assert len(list(tmp_path.glob("*.png"))) == 7


def test_every_kind_has_a_line_of_its_own(tmp_path):
    assert set(LINES) == set(KINDS)
    assert len(set(LINES.values())) == len(KINDS)


def drawn_names(x, y, names):
    """Return the axes and the boxes of the names beside dots."""
    figure = canvas.new_figure(800, 500, canvas.PAPER)
    axes = canvas.axes_at(figure, 50, 50, 700, 400)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    name_dots(axes, np.array(x), np.array(y), names, "black")
    return axes, [text.get_window_extent() for text in axes.texts]


def test_names_do_not_cover_each_other_nor_the_dots():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.4, 0.7, (2, 19))
    axes, boxes = drawn_names(x, y, SPACE.names[1:])
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    for dot in axes.transData.transform(np.stack([x, y], axis=1)):
        assert not any(box.contains(*dot) for box in boxes)


def test_names_stay_inside_and_near():
    axes, boxes = drawn_names([0.0, 1.0], [1.0, 0.0], ["left", "right $x$"])
    for box in boxes:
        assert axes.bbox.contains(*box.min)
        assert axes.bbox.contains(*box.max)
    assert not axes.lines
    crowd = drawn_names([0.5] * 12, [0.5] * 12, ["a longer name"] * 12)
    assert crowd[0].lines
