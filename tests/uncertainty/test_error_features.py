# SPDX-License-Identifier: MIT
"""Features of a point that tell how likely its label is wrong, against a slow loop."""

import math

import numpy as np
import pytest
from scans import SMALL
from scipy.special import softmax

from salsanext_cli import Scan, project
from salsanext_cli.uncertainty.error_features import FEATURES, error_features


def drawn(count: int, seed: int) -> Scan:
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3)).astype("f4") * [8, 8, 0.7]
    return Scan(points.astype("f4"), random.random(count).astype("f4"))


@pytest.mark.parametrize(("count", "seed"), [(1, 0), (40, 1), (900, 2)])
def test_features_are_those_of_a_slow_loop(count: int, seed: int) -> None:
    scan = drawn(count, seed)
    scan.points[0] = 0 if count > 1 else scan.points[0]
    image = project(scan, SMALL)
    random = np.random.default_rng(seed)
    shape = (4, image.height, image.width)
    probabilities = softmax(3 * random.normal(size=shape), axis=0).astype("f4")
    labels = random.integers(0, 4, count).astype(np.uint8)
    found = error_features(image, probabilities, labels)
    assert found.shape == (count, len(FEATURES))
    ranges = image.channels[0]
    for i in range(count):
        if image.pixel_of_point[i] < 0:
            assert np.isnan(found[i]).all()
            continue
        v, u = divmod(int(image.pixel_of_point[i]), image.width)
        own = sorted(probabilities[:, v, u].tolist())
        window = [
            (row, (u + step) % image.width)
            for row in range(v - 2, v + 3)
            for step in range(-2, 3)
            if 0 <= row < image.height and ranges[row, (u + step) % image.width] > 0
        ]
        logs = [math.log(max(ranges[place], 0.5)) for place in window]
        log_range = math.log(max(image.point_range[i], 0.5))
        expected = [
            probabilities[labels[i], v, u],
            own[-1],
            own[-1] - own[-2],
            -sum(p * math.log(p) for p in own),
            log_range,
            image.channels[3, v, u],
            log_range - math.log(max(ranges[v, u], 0.5)),
            np.mean([probabilities[:, r, c].argmax() == labels[i] for r, c in window]),
            np.std(logs),
            len(window) / 25,
            np.mean([probabilities[labels[i], r, c] for r, c in window]),
        ]
        assert found[i] == pytest.approx(expected, abs=1e-5)
