# SPDX-License-Identifier: MIT
import io

import numpy as np
import pytest
from matplotlib.image import imread
from scans import SMALL, make_scan

from salsanext_cli import Scan, label_space
from salsanext_cli.report.birds_eye import TITLE_PX
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import WRONG, screen_colours
from salsanext_cli.report.panel import STRIP_HEIGHT_PX
from salsanext_cli.report.scan_pictures import (
    HEAD_PX,
    NARROW_PX,
    WIDTH_PX,
    picture_of_results,
    scan_picture,
)
from salsanext_cli.results.result_folder import ScanResults

RED, GREEN = (255, 0, 0), (0, 255, 0)
SPACE = label_space()
CAR, SIDEWALK = 10, 48


def pixels(png):
    return (imread(io.BytesIO(png))[:, :, :3] * 255).round().astype(np.uint8)


def count(picture, colour):
    return (picture == np.array(colour)).all(axis=-1).sum()


def test_views_are_side_by_side():
    rng = np.random.default_rng(3)
    points = rng.uniform(-40, 40, (5000, 3)).astype(np.float32)
    points[:, 0] = abs(points[:, 0])
    views = {
        title: np.full((5000, 3), colour, np.uint8)
        for title, colour in {"truth": RED, "prediction": GREEN}.items()
    }
    drawn = pixels(scan_picture("00/1", points, views, (), [("car", (1, 2, 250))]))
    assert drawn.shape[1] == WIDTH_PX + 2 * MARGIN_PX
    size = (WIDTH_PX - MARGIN_PX) // 2
    top = HEAD_PX + TITLE_PX
    body = drawn[top : top + size].astype(int)
    starts = (MARGIN_PX, 2 * MARGIN_PX + size)
    for start, own, other in zip(starts, (0, 1), (1, 0), strict=True):
        view = body[:, start : start + size]
        coloured = view[..., own] - view[..., other] > 100
        assert coloured[: size // 2].sum() > 5000
        assert not coloured[size // 2 + 5 :].any()
        assert not (view[..., other] - view[..., own] > 100).any()
    assert count(drawn[top + size :], (1, 2, 250))


@pytest.fixture
def results():
    scan = make_scan()
    truth = np.full(len(scan), CAR, np.uint32)
    label = np.where(np.arange(len(scan)) % 2, CAR, SIDEWALK).astype(np.uint32)
    entropy = np.linspace(0, 1, len(scan), dtype=np.float32)
    return ScanResults(scan, label, truth, {"entropy": entropy}, SMALL)


def draw(results, *colours, strips=None, scales=None):
    strips = colours if strips is None else strips
    return picture_of_results("08/1", results, SPACE, SMALL, scales or {}, colours, strips)


def test_colours_and_legend_are_of_the_classes_that_are_there(results):
    of_class = dict(zip(SPACE.names, map(tuple, screen_colours(SPACE).tolist()), strict=True))
    drawn = pixels(draw(results, "label"))
    assert drawn.shape[1] == NARROW_PX + 2 * MARGIN_PX
    for name in ("car", "sidewalk"):
        assert count(drawn, of_class[name]) > 2000
    assert not count(drawn, of_class["road"])
    truth = pixels(draw(results, "truth"))
    assert not count(truth, of_class["sidewalk"])
    # What is absent keeps its place, so that frames of an animation stay alike.
    assert truth.shape == drawn.shape
    wrong = pixels(draw(results, "wrong"))
    assert count(wrong, WRONG) > 2000
    assert not count(wrong, of_class["car"])


def test_values_have_their_scale_beside_them(results):
    near, far = (draw(results, "entropy", scales={"entropy": (0, high)}) for high in (1, 2))
    assert near != far
    assert near == draw(results, "entropy", scales={"entropy": (0, 1)})
    with_strip, alone = pixels(near), pixels(draw(results, "entropy", strips=()))
    assert with_strip.shape[0] - alone.shape[0] > STRIP_HEIGHT_PX


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5, 3), np.nan), np.zeros((5, 3))])
def test_a_scan_without_a_measurement(points):
    count = len(points)
    labels = np.zeros(count, np.uint32)
    scan = Scan(points.astype(np.float32), np.zeros(count, np.float32))
    known = ScanResults(
        scan, labels, labels, {"entropy": np.full(count, np.nan, np.float32)}, SMALL
    )
    assert draw(known, "label", "wrong", "entropy", "range").startswith(b"\x89PNG")
