# SPDX-License-Identifier: MIT
"""Features of a point are those of loops over windows and regions of the image."""

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import project
from salsanext_cli.core.uncertainty.error_features import (
    COLUMNS,
    FEATURES,
    NEAR_M,
    NEAR_SHARE,
    NEAREST_M,
    ROWS,
    STEP,
    error_features,
    label_support,
    mean_of_regions,
)

CLASSES = 4


@pytest.fixture(scope="module")
def described():
    """Return a range image, its probabilities (C, H, W) and random labels of its points."""
    image = project(make_scan(900), SMALL)
    random = np.random.default_rng(5)
    powers = np.exp(random.normal(scale=2, size=(CLASSES, image.height, image.width)))
    probabilities = (powers / powers.sum(axis=0)).astype(np.float32)
    labels = probabilities.reshape(CLASSES, -1).argmax(axis=0)[image.pixel_of_point]
    others = random.random(len(labels)) < 0.3
    labels[others] = random.integers(0, CLASSES, others.sum())
    return image, probabilities, labels.astype(np.uint8)


def slow_support(image, probabilities, label: int, pixel: int) -> float:
    """Return the mean probability of a label in the window of a pixel, at its range."""
    v, u = divmod(pixel, image.width)
    ranges = image.channels[0]
    values = []
    for row in range(v - ROWS, v + ROWS + 1, STEP):
        for column in range(u - COLUMNS, u + COLUMNS + 1, STEP):
            if not 0 <= row < image.height:
                continue
            other = ranges[row, column % image.width]
            limit = max(NEAR_M, NEAR_SHARE * ranges[v, u])
            if other > 0 and abs(other - ranges[v, u]) <= limit:
                values.append(probabilities[label, row, column % image.width])
    return float(np.mean(values))


def test_the_support_of_a_label_is_that_of_a_slow_loop(described):
    image, probabilities, labels = described
    chosen = np.flatnonzero(image.pixel_of_point >= 0)[::7]
    pixels = image.pixel_of_point[chosen]
    support = label_support(image, probabilities, labels[chosen], pixels)
    pairs = zip(labels[chosen].tolist(), pixels.tolist(), strict=True)
    expected = [slow_support(image, probabilities, *pair) for pair in pairs]
    np.testing.assert_allclose(support, expected, rtol=1e-5)


def slow_regions(occupied: np.ndarray, classes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the means of the regions of pixels, by a search from each pixel."""
    height, width = occupied.shape
    steps = ((0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (1, -1))
    means = values.astype(float).copy()
    seen = np.zeros(occupied.shape, bool)
    for start in zip(*np.nonzero(occupied), strict=True):
        if seen[start]:
            continue
        region, todo = [], [start]
        seen[start] = True
        while todo:
            v, u = todo.pop()
            region.append((v, u))
            for dv, du in (*steps, *((-dv, -du) for dv, du in steps)):
                other = v + dv, (u + du) % width
                if not 0 <= other[0] < height or seen[other] or not occupied[other]:
                    continue
                if classes[other] == classes[start]:
                    seen[other] = True
                    todo.append(other)
        mean = np.mean([values[place] for place in region])
        for place in region:
            means[place] = mean
    return means


@pytest.mark.parametrize("share", [0.2, 0.6, 1.0])
def test_the_mean_of_a_region_is_that_of_a_search(share):
    random = np.random.default_rng(int(10 * share))
    occupied = random.random((9, 24)) < share
    classes = random.integers(0, 3, occupied.shape).astype(np.uint8)
    values = random.random(occupied.shape, np.float32)
    means = values.copy()
    mean_of_regions(occupied, classes, values, means)
    np.testing.assert_allclose(means, slow_regions(occupied, classes, values), rtol=1e-5)


def test_each_feature_is_what_its_name_states(described):
    image, probabilities, labels = described
    features = dict(zip(FEATURES, error_features(image, probabilities, labels).T, strict=True))
    seen = image.pixel_of_point >= 0
    assert all(np.isnan(values[~seen]).all() for values in features.values())
    pixels = image.pixel_of_point[seen]
    of_points = probabilities.reshape(CLASSES, -1)[:, pixels]
    ordered = np.sort(of_points, axis=0)
    of_label = of_points[labels[seen], np.arange(len(pixels))]
    depth = np.log(np.maximum(image.point_range[seen], NEAREST_M))
    of_pixel = np.log(np.maximum(image.channels[0].reshape(-1)[pixels], NEAREST_M))
    expected = {
        "probability of the label": of_label,
        "largest probability": ordered[-1],
        "margin to the second largest": ordered[-1] - ordered[-2],
        "entropy": -(of_points * np.log(of_points)).sum(axis=0),
        "log range": depth,
        "log range beyond that of the pixel": depth - of_pixel,
        "height above the sensor": image.channels[3].reshape(-1)[pixels],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(features[name][seen], values, atol=2e-6, err_msg=name)
