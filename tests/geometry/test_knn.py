# SPDX-License-Identifier: MIT
"""kNN refinement: against the slow loop, by hand, and against the published labels."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slow_geometry import published_refine, slow_refine

from salsanext_cli import KnnParameters, RangeImage, knn_refine, project, sensor
from salsanext_cli.errors import LabelError, UsageError


def image_of(ranges, pixels=None, point_range=None):
    """Build an image with these ranges; by default with one point per pixel."""
    ranges = np.asarray(ranges, np.float32)
    pixels = np.flatnonzero(ranges) if pixels is None else pixels
    pixels = np.asarray(pixels, np.int32)
    own = ranges.reshape(-1)[pixels] if point_range is None else point_range
    channels = np.zeros((5, *ranges.shape), np.float32)
    channels[0] = ranges
    no_point = np.full(ranges.shape, -1, np.int32)
    return RangeImage(channels, pixels, no_point, np.asarray(own, np.float32))


def some_points(image, step):
    """Return an image with every n-th point only."""
    return replace(
        image, pixel_of_point=image.pixel_of_point[::step], point_range=image.point_range[::step]
    )


def slow(image, labels, parameters):
    rules = (parameters.k, parameters.window, parameters.sigma, parameters.cutoff)
    return slow_refine(image, labels, *rules)


@st.composite
def problems(draw):
    height, width = draw(st.integers(1, 6)), draw(st.integers(1, 9))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    few, classes = draw(st.integers(1, 12)), draw(st.integers(2, 6))
    ranges = random.integers(0, few, (height, width)) * draw(st.sampled_from([0.3, 1.0, 7.7]))
    pixels = random.choice([-1, *np.flatnonzero(ranges)], draw(st.integers(0, 40)))
    own = np.where(pixels < 0, 0, random.integers(1, few + 1, len(pixels)) * 0.7)
    window = draw(st.sampled_from([1, 3, 5, 7]))
    parameters = KnnParameters(
        draw(st.integers(1, window**2)),
        window,
        draw(st.sampled_from([0.1, 1.0, 3.0])),
        draw(st.sampled_from([0.0, 0.5, 1.0, 5.0, math.inf])),
    )
    labels = random.integers(0, classes, (height, width))
    return image_of(ranges, pixels, own), labels, parameters


@given(problems())
def test_equals_the_slow_loop(problem):
    image, labels, parameters = problem
    expected = slow(image, labels, parameters)
    refined = knn_refine(image, labels, parameters=parameters)
    assert refined.dtype == np.uint8
    np.testing.assert_array_equal(refined, expected)


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("cell", [1, 9])
def test_many_points_on_any_number_of_threads(rings, cell, threads, monkeypatch):
    """Labels that change with every pixel, and labels in patches of 9 × 9."""
    monkeypatch.setattr("salsanext_cli.compiled.MIN_SLICE_ITEMS", 100)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    image = project(rings, sensor("hdl64").resized(width=512))
    labels = np.random.default_rng(1).integers(0, 20, (64, 512), np.uint8)
    labels = labels[::cell, ::cell].repeat(cell, 0).repeat(cell, 1)[:64, :512]
    parameters = KnnParameters(cutoff=4.0)
    refined = knn_refine(image, labels, parameters=parameters)
    np.testing.assert_array_equal(refined[::97], slow(some_points(image, 97), labels, parameters))


ROW = [5.0] * 8
NEAR, FAR = [5.0, 5.0, 5.0, 5.1, 5.1, 5.2, 5.2, 90], [5.0, 5.0, 5.0, 6.0]


@pytest.mark.parametrize(
    ("ranges", "labels", "pixel", "parameters", "expected"),
    [
        pytest.param(ROW, [1, 2, 3, 3, 3, 3, 2, 2], 0, (), 2, id="periodic in azimuth"),
        pytest.param(ROW, [0] * 8, 3, (), 0, id="without a vote the label stays"),
        pytest.param(ROW, [9, 9, 2, 9, 2, 9, 9, 9], 3, (4, 3), 2, id="lowest of equals"),
        pytest.param(ROW, [9, 9, 2, 9, 1, 9, 9, 9], 3, (3, 3), 1, id="lowest of three"),
        pytest.param(NEAR, [0, 4, 0, 6, 6, 6, 6, 0], 1, (3, 5), 4, id="label 0 takes a place"),
        pytest.param(NEAR, [0, 4, 0, 6, 6, 6, 6, 0], 1, (5, 7), 6, id="but has no vote"),
        pytest.param(FAR, [8, 4, 8, 9], 1, (3, 3, 1.0, 0.0), 8, id="at the cutoff"),
    ],
)
def test_one_row_by_hand(ranges, labels, pixel, parameters, expected):
    image, parameters = image_of([ranges], [pixel]), KnnParameters(*parameters)
    assert knn_refine(image, [labels], parameters=parameters).tolist() == [expected]


@pytest.mark.parametrize(
    "wrong",
    [
        *({"k": 0}, {"k": 26}, {"k": 2, "window": 1}, {"window": 4}, {"window": -1}),
        *({"sigma": 0.0}, {"sigma": math.nan}, {"sigma": math.inf}),
        *({"cutoff": -0.1}, {"cutoff": math.nan}),
    ],
)
def test_impossible_parameters(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        KnnParameters(**wrong)


@pytest.mark.parametrize(
    ("labels", "pixel", "found"),
    [
        (np.zeros((8, 3), int), 0, "shape"),
        (np.zeros((3, 8)), 0, "dtype"),
        (np.full((3, 8), 20), 0, "20"),
        (np.full((3, 8), -1), 0, "-1"),
        (np.zeros((3, 8), int), -2, "-2"),
        (np.zeros((3, 8), int), 24, "24"),
    ],
)
def test_labels_and_pixels_that_do_not_fit(labels, pixel, found):
    with pytest.raises(LabelError, match=found):
        knn_refine(image_of(np.ones((3, 8)), [pixel], [1]), labels)
    with pytest.raises(UsageError, match="257"):
        knn_refine(image_of(np.ones((3, 8))), np.zeros((3, 8), int), class_count=257)


PUBLISHED = [("argmax_image", "point_labels"), ("blob_image", "blob_point_labels")]


@pytest.mark.real
@pytest.mark.parametrize(("image_name", "labels_name"), PUBLISHED)
def test_published_labels(golden, real_image, image_name, labels_name):
    """The published rules give the published labels, and every difference of ours is a correction.

    Corrections are: the window reaches over an edge of the image, or there is no vote.
    """
    with np.load(golden / "projection.npz") as projection, np.load(golden / "knn.npz") as knn:
        column, row = (projection[name].astype(int) for name in ("pixel_x", "pixel_y"))
        point_range, holder = projection["point_range"], projection["pixel_to_point"]
        labels, published = knn[image_name], knn[labels_name]
    ranges = np.where(holder >= 0, point_range[holder], np.float32(-1))
    refined = published_refine(ranges, labels, column, row, point_range)
    np.testing.assert_array_equal(refined, published)

    ours = knn_refine(real_image, labels)
    at_edge = (column < 2) | (column >= 2046) | (row < 2) | (row >= 62)
    no_vote = (ours == 0) & (labels[row, column] == 0) & (published == 1)
    differs = ours != published
    assert differs.mean() < 0.005
    assert (at_edge | no_vote)[differs].all()
