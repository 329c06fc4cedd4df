# SPDX-License-Identifier: MIT
"""Intensity: its quantiles, its match to that of training, and values that are none."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, project, sensor
from salsanext_cli.core.geometry.intensity import (
    SAMPLE,
    dependence,
    intensity_quantiles,
    match_intensity,
    why_no_intensity,
)
from salsanext_cli.core.geometry.point_sample import sample_places
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.io.formats import SCAN_SUFFIXES, read_scan

TARGET = tuple(np.linspace(0.1, 0.9, INTENSITY_LEVELS) ** 2)


def image_of(intensity, seed=0):
    scan = make_scan(len(intensity), seed)
    return project(Scan(scan.points, np.asarray(intensity, np.float32)), SMALL).channels


def slowly_mapped(value, source, target):
    """Return where a value comes to lie, by looking at every pair of neighbouring quantiles."""
    at_value = [end for start, end in zip(source, target, strict=True) if start == value]
    if at_value:
        return sum(at_value) / len(at_value)
    if value < source[0] or value > source[-1]:
        edge = source[0] if value < source[0] else source[-1]
        return slowly_mapped(edge, source, target)
    low = max(quantile for quantile in source if quantile < value)
    high = min(quantile for quantile in source if quantile > value)
    share = (value - low) / (high - low)
    ends = (slowly_mapped(low, source, target), slowly_mapped(high, source, target))
    return ends[0] + share * (ends[1] - ends[0])


def bright(power=1, seed=0, scale=1.0, count=4000):
    """Return a range image of random intensities, and their quantiles."""
    values = scale * np.random.default_rng([seed, 7]).random(count) ** power
    image = image_of(values, seed)
    return image, np.quantile(image[4][image[0] > 0], np.linspace(0, 1, INTENSITY_LEVELS))


def test_quantiles_are_the_mean_over_the_images():
    images, each = zip(*(bright(power) for power in (1, 3)), strict=True)
    np.testing.assert_allclose(intensity_quantiles(images), np.mean(each, axis=0), rtol=1e-5)
    empty = np.zeros_like(images[0])
    assert intensity_quantiles([]) == intensity_quantiles([empty]) == ()
    assert intensity_quantiles([*images, empty]) == intensity_quantiles(images)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 50)), min_size=2, max_size=30))
def test_dependence_equals_the_slow_way(pairs):
    values, on = zip(*pairs, strict=True)
    if len({*values}) == 1:
        return
    up_to = [sum(b <= a for b in values) for a in values]
    from_on = [sum(b >= a for b in values) for a in values]
    ordered = [up_to[i] for i in sorted(range(len(on)), key=lambda i: on[i])]
    steps = sum(abs(b - a) for a, b in pairwise(ordered))
    slow = 1 - len(on) * steps / (2 * sum(n * (len(on) - n) for n in from_on))
    assert dependence(np.array([up_to, from_on]), np.array(on)) == pytest.approx(slow)


IN_TURN = make_scan(4000)
SHUFFLED = np.random.default_rng(2).permutation(4000)
STREET = Scan(IN_TURN.points[SHUFFLED], IN_TURN.intensity[SHUFFLED])
"""A scan in which the order of the points shows nothing else, unlike that of a scanner's turn."""
X, Y, Z = STREET.points.T
RANGES = np.linalg.norm(STREET.points, axis=1)
RINGS = np.round(np.degrees(np.arcsin(Z / RANGES)) + 25).astype(int)
IDS = np.random.default_rng(1).permutation(64)


@pytest.mark.parametrize(
    ("intensity", "reason"),
    [
        (STREET.intensity, "^$"),
        (np.floor(3 * STREET.intensity), "^$"),
        (STREET.intensity / RANGES**2, "^$"),
        (np.zeros(4000), "100 % of the points have the same"),
        (STREET.intensity > 0.975, "9[78] % of the points have the same"),
        (np.full(4000, np.nan), "100 % of the points have no intensity: NaN or above"),
        (np.where(STREET.intensity < 0.3, np.inf, STREET.intensity), "(2[789]|3.) % of the points"),
        (RANGES, "follow the range"),
        (RINGS, "follow the elevation"),
        (IDS[RINGS], "follow the elevation"),
        (np.arctan2(Y, X) % 1, "follow the azimuth"),
        (np.arange(4000) * 1e-6, "follow the order"),
    ],
)
def test_values_that_are_not_intensities(intensity, reason):
    assert re.search(reason, why_no_intensity(STREET.points, np.asarray(intensity, np.float32)))


@pytest.mark.real
def test_every_real_intensity_is_one_and_no_other_column(real_data):
    four_columns = sensor("hdl64-512")
    five_columns = replace(four_columns, columns=("x", "y", "z", "intensity", "ring"))
    without = set()
    # `reported` holds files that are no scans, or whose origin is not at the sensor.
    folders = [path for path in (real_data / "data").iterdir() if path.name != "reported"]
    files = [path for folder in sorted(folders) for path in sorted(folder.rglob("*.*"))]
    for path in files[::9]:
        if not path.name.endswith(SCAN_SUFFIXES) or path.name == "poses.txt":
            continue
        layout = five_columns if "five_columns_h" in path.name else four_columns
        scan = read_scan(path, layout)
        image = project(scan, layout).channels
        points = image[1:4, image[0] > 0].T
        intensity = image[4, image[0] > 0]
        if why_no_intensity(scan.points, scan.intensity) or why_no_intensity(points, intensity):
            without.add(path.name)
        ranges = np.linalg.norm(points, axis=1)
        for other in (ranges, np.round(np.degrees(np.arcsin(points[:, 2] / ranges)))):
            assert "follow" in why_no_intensity(points, other)
    assert without <= {"ascii_rgb_normals.ply", "float64_xyz_only.ply"}


@given(st.lists(st.sampled_from([0.0, 0.1, 0.5, 7.0, 255.0]), min_size=3, max_size=40))
def test_equals_the_slow_way_with_ties_and_beyond_the_ends(values):
    image = image_of(values)
    source = sorted(np.random.default_rng(len(values)).choice(values, INTENSITY_LEVELS).tolist())
    matched = match_intensity(image, source, TARGET)
    occupied = image[0] > 0
    expected = [slowly_mapped(float(v), source, TARGET) for v in image[4][occupied]]
    np.testing.assert_allclose(matched[4][occupied], expected, rtol=1e-5)
    assert (matched[4][~occupied] == 0).all()
    assert np.array_equal(matched[:4], image[:4])


def test_the_same_points_decide_whether_an_image_and_its_points_have_an_intensity():
    """Both look at a sample of equal places: with one value there, both find none."""
    image, quantiles = bright(count=8000)
    occupied = np.flatnonzero(image[0] > 0)
    assert len(occupied) > SAMPLE
    sampled = occupied[sample_places(len(occupied), SAMPLE)]
    image[4].flat[sampled] = 7
    points = image[1:4].reshape(3, -1)[:, occupied].T
    assert "same value" in why_no_intensity(points, image[4].flat[occupied])
    matched = match_intensity(image, quantiles, TARGET)
    assert matched[4].flat[occupied] == pytest.approx(np.mean(TARGET))
