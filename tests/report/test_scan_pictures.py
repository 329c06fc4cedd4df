# SPDX-License-Identifier: MIT
"""Pictures of scans."""

import io
from dataclasses import replace

import numpy as np
import pytest
from calls import calls_of
from matplotlib.image import imread
from scans import SMALL, make_scan

from salsanext_cli import Scan, label_space
from salsanext_cli.report import scan_pictures
from salsanext_cli.report.canvas import MARGIN_PX
from salsanext_cli.report.colours import EMPTY, NOT_JUDGED, WRONG, screen_colours
from salsanext_cli.runs.results.scan_results import ScanResults, picture_columns

RED, GREEN = (255, 0, 0), (0, 255, 0)
SPACE = label_space()
CAR, SIDEWALK = 10, 48


@pytest.fixture(autouse=True)
def half_as_wide(monkeypatch):
    """Draw pictures of half the width, which have a quarter of the pixels."""
    for name in ("WIDTH_PX", "NARROW_PX"):
        monkeypatch.setattr(scan_pictures, name, getattr(scan_pictures, name) // 2)


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
    drawn = pixels(scan_pictures.scan_picture("00/1", points, views, (), [("car", (1, 2, 250))]))
    assert drawn.shape[1] == scan_pictures.WIDTH_PX + 2 * MARGIN_PX
    size = (scan_pictures.WIDTH_PX - MARGIN_PX) // 2
    top = scan_pictures.HEAD_PX + scan_pictures.VIEW_TITLE_PX
    body = drawn[top : top + size].astype(int)
    starts = (MARGIN_PX, 2 * MARGIN_PX + size)
    for start, channel, other in zip(starts, (0, 1), (1, 0), strict=True):
        view = body[:, start : start + size]
        coloured = view[..., channel] - view[..., other] > 100
        assert coloured[: size // 2].sum() > 5000
        assert not coloured[size // 2 + 5 :].any()
        assert not (view[..., other] - view[..., channel] > 100).any()
    assert count(drawn[top + size :], (1, 2, 250))


@pytest.fixture
def results():
    scan = make_scan()
    truth = np.full(len(scan), CAR, np.uint32)
    label = np.where(np.arange(len(scan)) % 2, CAR, SIDEWALK).astype(np.uint32)
    entropy = np.linspace(0, 1, len(scan), dtype=np.float32)
    return ScanResults(
        scan=scan, label=label, truth=truth, uncertainty={"entropy": entropy}, sensor=SMALL
    )


def draw(results, *colours, strips=None, scales=None):
    strips = colours if strips is None else strips
    given = ("08/1", results, SPACE, SMALL, scales or {}, colours, strips)
    return scan_pictures.picture_of_results(*given)


def test_pictures_show_the_classes_of_the_scan(results):
    of_class = dict(zip(SPACE.names, map(tuple, screen_colours(SPACE).tolist()), strict=True))
    drawn = pixels(draw(results, "label"))
    assert drawn.shape[1] == scan_pictures.NARROW_PX + 2 * MARGIN_PX
    for name in ("car", "sidewalk"):
        assert count(drawn, of_class[name]) > 2000
    assert not count(drawn, of_class["road"])
    truth = pixels(draw(results, "truth"))
    assert not count(truth, of_class["sidewalk"])
    # Absent classes stay in the legend, so that frames of an animation have one size.
    assert truth.shape == drawn.shape
    wrong = pixels(draw(results, "wrong"))
    assert count(wrong, WRONG) > 2000
    assert not count(wrong, of_class["car"])


def test_points_that_are_not_judged_are_seen_and_named(results):
    """A third of the points have no true label; other pictures do not have their colour."""
    unlabelled = np.arange(len(results.scan)) % 3 == 0
    some = replace(results, truth=np.where(unlabelled, 0, results.truth).astype(np.uint32))
    drawn, every = pixels(draw(some, "wrong")), pixels(draw(results, "wrong"))
    assert count(drawn, NOT_JUDGED) > 2000
    assert 0 < count(every, NOT_JUDGED) < 1000  # Of the legend
    assert count(drawn, WRONG) < count(every, WRONG)
    assert not count(pixels(draw(some, "truth")), NOT_JUDGED)
    # Pixels without a point stay empty.
    assert count(drawn, EMPTY) > 2000


def test_a_scan_alone_has_a_caption(results):
    alone = replace(results, label=None, truth=None, uncertainty={})
    columns = picture_columns(alone, SPACE)
    assert scan_pictures.columns_from_above(columns) == ["height", "intensity"]
    assert scan_pictures.columns_of_strips(columns) == ["height", "intensity", "range"]
    colours = ("height", "intensity")
    with_caption, without = pixels(draw(alone, *colours)), pixels(draw(results, *colours))
    assert with_caption.shape[0] > without.shape[0]


def test_the_height_is_that_above_the_sensor(results):
    low = replace(results, sensor=replace(SMALL, origin=(0, 0, -1)))
    scan = results.scan
    assert low.height == pytest.approx(scan.points[:, 2] + 1, abs=1e-5)
    unmeasured = replace(scan, points=np.zeros_like(scan.points))
    assert np.isnan(replace(low, scan=unmeasured).height).all()


def test_points_far_from_the_sensor_are_in_the_picture():
    rng = np.random.default_rng(2)
    points = rng.normal(0, 10, (2000, 3)).astype(np.float32)
    colours = np.full((2000, 3), RED, np.uint8)
    for shift in ((0, 0, 0), (5000, -300, 20)):
        drawn = scan_pictures.scan_picture("", points + np.array(shift, np.float32), {"": colours})
        assert count(pixels(drawn), RED) > 1000


def test_strips_of_values_have_their_scale(results):
    near, far = (draw(results, "entropy", scales={"entropy": (0, high)}) for high in (1, 2))
    assert near != far
    assert near == draw(results, "entropy", scales={"entropy": (0, 1)})
    with_strip, alone = pixels(near), pixels(draw(results, "entropy", strips=()))
    assert with_strip.shape[0] - alone.shape[0] > scan_pictures.STRIP_HEIGHT_PX


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((5, 3), np.nan), np.zeros((5, 3))])
def test_a_scan_without_a_measurement(points):
    count = len(points)
    labels = np.zeros(count, np.uint32)
    scan = Scan(points.astype(np.float32), np.zeros(count, np.float32))
    entropy = np.full(count, np.nan, np.float32)
    known = ScanResults(
        scan=scan, label=labels, truth=labels, uncertainty={"entropy": entropy}, sensor=SMALL
    )
    assert draw(known, "label", "wrong", "entropy", "range").startswith(b"\x89PNG")


def seen(points, colours, **how):
    points, colours = np.array(points, np.float32), np.array(colours, np.uint8)
    return scan_pictures.raster(points, colours, reach=10, size=20, **how)


def test_forward_is_up_and_left_is_left():
    for point, row, column in (
        ((9.5, 0.5, 0), 0, 9),
        ((-9.5, 0.5, 0), 19, 9),
        ((0.5, 9.5, 0), 9, 0),
        ((0.5, -9.5, 0), 9, 19),
    ):
        picture = seen([point], [RED])
        assert np.argwhere((picture == RED).all(axis=-1)).tolist() == [[row, column]]
        assert ((picture == EMPTY).all(axis=-1)).sum() == 399


@pytest.mark.parametrize("spread", [1, 2, 3])
def test_a_higher_point_hides_a_lower_one(spread):
    points = [(0.5, 0.5, 2), (0.5, 0.5, -1), (0.5, 0.5, 1)]
    picture = seen(points, [RED, GREEN, GREEN], spread=spread)
    assert (picture == RED).all(axis=-1).sum() == spread**2
    assert not (picture == GREEN).all(axis=-1).any()


def test_pixels_are_means_of_blocks_of_pixels():
    large = np.random.default_rng(0).integers(0, 256, (12, 8, 3)).astype(np.uint8)
    means = large.reshape(6, 2, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_array_equal(scan_pictures.averaged(large), means.round())


def test_a_large_scan_is_drawn_in_parts(monkeypatch):
    rng = np.random.default_rng(1)
    points = rng.uniform(-10, 10, (500, 3))
    colours = rng.integers(0, 256, (500, 3))
    whole = seen(points, colours, spread=3)
    monkeypatch.setattr(scan_pictures, "RASTER_POINTS", 7)
    assert (seen(points, colours, spread=3) == whole).all()


@pytest.mark.parametrize("point", [(np.nan, 0, 0), (np.inf, 0, 0), (10.01, 0, 0), (0, -1e9, 0)])
def test_points_outside_the_picture_are_skipped(point):
    assert (seen([point], [RED]) == EMPTY).all()
    assert (seen(np.zeros((0, 3)), np.zeros((0, 3))) == EMPTY).all()


@pytest.mark.parametrize(
    ("farthest", "reach"),
    [(0.5, 5), (4.9, 5), (5.1, 10), (19, 20), (30, 45), (50, 45), (90, 100), (2000, 1500)],
)
def test_a_picture_from_above_is_as_wide_as_the_scan(farthest, reach, monkeypatch):
    monkeypatch.setattr("salsanext_cli.report.canvas.png_of", lambda _: b"")
    points = np.zeros((1000, 3), np.float32)
    points[:700, 1] = np.linspace(0.1, farthest, 700)
    points[0, 0], points[1] = 80, np.nan  # A far point, and one without a measurement
    with calls_of(scan_pictures.raster) as rasters:
        scan_pictures.scan_picture("", points, {"": np.zeros((1000, 3), np.uint8)})
    assert [call["reach"] for call in rasters] == [reach]
