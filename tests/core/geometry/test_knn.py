# SPDX-License-Identifier: MIT
"""kNN refinement: against the slow loop and against the published labels."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli import KnnParameters, RangeImage, knn_refine, project, sensor
from salsanext_cli.core.errors import LabelError, UsageError

F = np.float32


def slow_weights(window, sigma):
    """Return 1 − a Gaussian whose sum over the window is 1."""
    half = window // 2
    gaussian = {
        (dy, dx): math.exp(-(dx * dx + dy * dy) / (2 * sigma * sigma))
        for dy in range(-half, half + 1)
        for dx in range(-half, half + 1)
    }
    total = sum(gaussian.values())
    return {offset: F(1 - value / total) for offset, value in gaussian.items()}


def slow_refine(image, labels, k, window, sigma, cutoff):
    """Compare every point with every pixel of its window, once."""
    height, width = image.height, image.width
    ranges = image.channels[0]
    weights = slow_weights(window, sigma)
    refined = np.zeros(len(image.pixel_of_point), np.uint8)
    for i, pixel in enumerate(image.pixel_of_point):
        if pixel < 0:
            continue
        row, column = divmod(int(pixel), width)
        neighbours = {(row, column): (F(0), -1)}
        for place, ((dy, dx), weight) in enumerate(weights.items()):
            v, u = row + dy, (column + dx) % width
            comes_round = not -((width - 1) // 2) <= dx <= width // 2
            if comes_round or not 0 <= v < height or (v, u) in neighbours or ranges[v, u] == 0:
                continue
            distance = abs(ranges[v, u] - image.point_range[i]) * weight
            neighbours[v, u] = (distance, place)
        nearest = sorted(neighbours, key=neighbours.__getitem__)[:k]
        voters = [int(labels[vu]) for vu in nearest if neighbours[vu][0] <= cutoff]
        votes = [voter for voter in voters if voter > 0]
        own = int(labels[row, column])
        refined[i] = min(votes, key=lambda label: (-votes.count(label), label), default=own)
    return refined


def published_refine(ranges, labels, pixel_x, pixel_y, point_range, class_count=20):
    """Refine by the published edge rules: padding of range 0 and label 0, no vote is class 1.

    `ranges` is -1 where empty, which the published code turns to infinity.
    """
    framed_ranges, framed_labels = np.pad(ranges, 2), np.pad(labels, 2)
    distances, candidates = [], []
    for (dy, dx), weight in slow_weights(5, 1.0).items():
        there = (pixel_y + 2 + dy, pixel_x + 2 + dx)
        neighbour = framed_ranges[there]
        neighbour = np.where(neighbour < 0, F(np.inf), neighbour)
        neighbour = point_range if dy == dx == 0 else neighbour
        distances.append(np.abs(neighbour - point_range) * weight)
        candidates.append(framed_labels[there])
    distances, candidates = np.array(distances), np.array(candidates)
    nearest = np.argsort(distances, axis=0, kind="stable")[:5]
    too_far = np.take_along_axis(distances, nearest, 0) > 1
    voters = np.take_along_axis(candidates, nearest, 0)
    votes = [((voters == label) & ~too_far).sum(axis=0) for label in range(1, class_count)]
    return np.argmax(votes, axis=0) + 1


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


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("cell", [1, 9])
def test_many_points_on_any_number_of_threads(rings, cell, threads, monkeypatch):
    """Labels that change with every pixel, and labels in patches of 9 × 9."""
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    image = project(rings, sensor("hdl64").resized(width=512))
    labels = np.random.default_rng(1).integers(0, 20, (64, 512), np.uint8)
    labels = labels[::cell, ::cell].repeat(cell, 0).repeat(cell, 1)[:64, :512]
    parameters = KnnParameters(cutoff=4.0)
    refined = knn_refine(image, labels, parameters=parameters)
    pixels, ranges = image.pixel_of_point[::97], image.point_range[::97]
    some = replace(image, pixel_of_point=pixels, point_range=ranges)
    np.testing.assert_array_equal(refined[::97], slow(some, labels, parameters))


def test_impossible_parameters_labels_and_pixels_are_refused():
    for wrong in (
        *({"k": 0}, {"k": 26}, {"k": 2, "window": 1}, {"window": 4}, {"window": -1}),
        *({"sigma": 0.0}, {"sigma": math.nan}, {"sigma": math.inf}),
        *({"cutoff": -0.1}, {"cutoff": math.nan}),
    ):
        with pytest.raises(UsageError):
            KnnParameters(**wrong)
    for labels, pixel, problem in (
        (np.zeros((8, 3), int), 0, "shape"),
        (np.zeros((3, 8)), 0, "dtype"),
        (np.full((3, 8), 20), 0, "20"),
        (np.full((3, 8), -1), 0, "-1"),
        (np.zeros((3, 8), int), -2, "-2"),
        (np.zeros((3, 8), int), 24, "24"),
    ):
        with pytest.raises(LabelError, match=problem):
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
