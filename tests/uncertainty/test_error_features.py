# SPDX-License-Identifier: MIT
"""Features of a point that tell how likely its label is wrong, against a slow loop."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scans import SMALL
from scipy.special import softmax

from salsanext_cli import Scan, project
from salsanext_cli.uncertainty.error_features import FEATURES, error_features


@pytest.mark.parametrize("threads", [1, 5])
@pytest.mark.parametrize(
    ("count", "width", "block"),
    [(0, 128, 1), (1, 128, 1), (40, 8, 2), (900, 128, 1), (900, 128, 12), (9000, 128, 7)],
)
def test_features_are_those_of_a_slow_loop(count, width, block, threads, monkeypatch):
    """Large blocks of pixels are alike, so that regions are; of many points some are compared."""
    monkeypatch.setattr("salsanext_cli.compiled.MIN_SLICE_ITEMS", 100)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    random = np.random.default_rng(count + block)
    points = random.normal(size=(count, 3)).astype("f4") * np.float32([8, 8, 0.7])
    scan = Scan(points, random.random(count).astype("f4"))
    # Points in the origin have no pixel: some where the threads' slices meet.
    borders = [count * part // threads for part in range(threads) if count > threads]
    scan.points[[border - step for border in borders for step in (0, 1)]] = 0
    image = project(scan, replace(SMALL, width=width))
    random = np.random.default_rng(block)
    coarse = random.normal(size=(4, image.height // block + 1, image.width // block + 1))
    logits = coarse.repeat(block, 1).repeat(block, 2)[:, : image.height, : image.width]
    logits = 3 * logits + random.normal(size=logits.shape) * (0.3 if block > 1 else 1)
    probabilities = softmax(logits, axis=0).astype("f4")
    labels = random.integers(0, 4, count).astype(np.uint8)
    found = error_features(image, probabilities, labels)
    assert found.shape == (count, len(FEATURES))
    ranges = image.channels[0]
    classes, largest = probabilities.argmax(axis=0), probabilities.max(axis=0)
    for i in range(0, count, 1 + count // 400):
        if image.pixel_of_point[i] < 0:
            assert np.isnan(found[i]).all()
            continue
        v, u = divmod(int(image.pixel_of_point[i]), image.width)
        own = sorted(probabilities[:, v, u].tolist())
        around = [
            probabilities[labels[i], v + dv, (u + du) % image.width]
            for dv in (-4, -2, 0, 2, 4)
            for du in range(-8, 9, 2)
            if 0 <= v + dv < image.height
            and ranges[v + dv, (u + du) % image.width] > 0
            and abs(ranges[v + dv, (u + du) % image.width] - ranges[v, u])
            <= max(1, 0.05 * ranges[v, u])
        ]
        log_range = math.log(max(image.point_range[i], 0.5))
        expected = [
            probabilities[labels[i], v, u],
            own[-1],
            own[-1] - own[-2],
            -sum(p * math.log(p) for p in own),
            np.mean(around),
            np.mean([largest[place] for place in region(ranges > 0, classes, (v, u))]),
            log_range - math.log(max(ranges[v, u], 0.5)),
            log_range,
            image.channels[3, v, u],
        ]
        assert found[i] == pytest.approx(expected, abs=1e-5)


def region(occupied, classes, start: tuple[int, int]) -> set[tuple[int, int]]:
    """Return the pixels that can be reached from one in steps between pixels of its class."""
    height, width = occupied.shape
    steps = [(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1)]
    steps += [(0, 2), (0, -2), (2, 0), (-2, 0)]
    found, waiting = {start}, [start]
    while waiting:
        v, u = waiting.pop()
        for dv, du in steps:
            place = (v + dv, (u + du) % width)
            free = 0 <= place[0] < height and occupied[place] and place not in found
            if free and classes[place] == classes[start]:
                found.add(place)
                waiting.append(place)
    return found
