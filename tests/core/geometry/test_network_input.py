# SPDX-License-Identifier: MIT
"""Input of a network: normalisation, intensity matched to that of training, rows filled."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, Sensor, project, sensor
from salsanext_cli.core.geometry.network_input import (
    FILLED_ROWS,
    MAX_GAP,
    dependence,
    fill_rows,
    fills_rows,
    intensity_quantiles,
    match_intensity,
    normalise,
    row_gaps,
    why_no_intensity,
    with_filled_gaps,
)
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.io.formats import SCAN_SUFFIXES, read_scan


def test_closed_form_and_empty_pixels():
    tilted = Sensor("s", 1, -1, 1, 2, means=(1, 2, 3, 4, 5), stds=(1, 2, 4, 8, 16))
    channels = np.zeros((5, 1, 2), np.float32)
    channels[:, 0, 1] = (3, 4, 5, 6, 7)
    normal = normalise(channels, tilted)
    assert normal.dtype == np.float32
    assert normal[:, 0, 1].tolist() == [2, 1, 0.5, 0.25, 0.125]
    assert not normal[:, 0, 0].any()
    assert channels[0, 0, 1] == 3, "the argument is left alone"


@pytest.mark.real
def test_published_network_input(real_image, golden):
    """Float16, and the published range may differ by 1 in its last bit."""
    published = np.load(golden / "network_input.npy")
    ours = normalise(real_image.channels, sensor("hdl64")).astype(np.float16)
    assert (ours == published).mean() > 0.9999
    np.testing.assert_allclose(ours, published, rtol=2**-10, atol=2**-17 / 12.32)
    assert not ours[:, real_image.channels[0] == 0].any()


TARGET = tuple(np.linspace(0.1, 0.9, INTENSITY_LEVELS) ** 2)


def image_of(intensity, seed=0):
    scan = make_scan(len(intensity), seed)
    return project(Scan(scan.points, np.asarray(intensity, np.float32)), SMALL).channels


def slowly_mapped(value, source, target):
    """Return where a value comes to lie, by looking at every pair of neighbouring quantiles."""
    at = [wanted for known, wanted in zip(source, target, strict=True) if known == value]
    if at:
        return sum(at) / len(at)
    if value < source[0] or value > source[-1]:
        edge = source[0] if value < source[0] else source[-1]
        return slowly_mapped(edge, source, target)
    low = max(known for known in source if known < value)
    high = min(known for known in source if known > value)
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


STREET = make_scan(4000)
X, Y, Z = STREET.points.T
RANGES = np.linalg.norm(STREET.points, axis=1)
RINGS = np.round(np.degrees(np.arcsin(Z / RANGES)) + 25).astype(int)
IDS = np.random.default_rng(1).permutation(64)


def test_values_that_are_not_intensities():
    for intensity, reason in (
        (STREET.intensity, "^$"),
        (np.floor(3 * STREET.intensity), "^$"),
        (STREET.intensity / RANGES**2, "^$"),
        (np.zeros(4000), "100 % of the points have the same"),
        (STREET.intensity > 0.975, "9[78] % of the points have the same"),
        (np.full(4000, np.nan), "100 % of the points have no intensity: NaN or above"),
        (np.where(STREET.intensity < 0.3, np.inf, STREET.intensity), "(28|29|3.) % of the points"),
        (RANGES, "follow the range"),
        (RINGS, "follow the elevation"),
        (IDS[RINGS], "follow the elevation"),
        (np.arctan2(Y, X) % 1, "follow the azimuth"),
        (np.arange(4000) * 1e-6, "follow the order"),
    ):
        assert re.search(reason, why_no_intensity(STREET.points, np.asarray(intensity, np.float32)))


@pytest.mark.real
def test_every_real_intensity_is_one_and_no_other_column(real_data):
    usual, without = sensor("hdl64-512"), set()
    five = replace(usual, columns=("x", "y", "z", "intensity", "ring"))
    # `reported` holds files that are no scans, or whose origin is not at the sensor.
    folders = [path for path in (real_data / "data").iterdir() if path.name != "reported"]
    files = [path for folder in sorted(folders) for path in sorted(folder.rglob("*.*"))]
    for path in files[::9]:
        if not path.name.endswith(SCAN_SUFFIXES) or path.name == "poses.txt":
            continue
        of = five if "five_columns_h" in path.name else usual
        scan = read_scan(path, of)
        image = project(scan, of).channels
        points, intensity = image[1:4, image[0] > 0].T, image[4, image[0] > 0]
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


def image(share, height=24, width=30, seed=0):
    """Return a range image with a share of its pixels occupied."""
    random = np.random.default_rng(seed)
    channels = random.uniform(0.5, 9, (5, height, width)).astype(np.float32)
    return channels * (random.random((height, width)) < share)


def column_gaps(ranges):
    """Return the places in gaps of one column, pixel by pixel."""
    full = [row for row, distance in enumerate(ranges) if distance > 0]
    return [
        row
        for above, below in pairwise(full)
        for row in range(above + 1, below)
        if below - above - 1 <= MAX_GAP
    ]


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.9, 1.0])
def test_gaps_equal_a_loop_over_columns(share):
    images = [image(share, seed=seed) for seed in range(3)]
    gaps = sum(len(column_gaps(column)) for one in images for column in one[0].T)
    occupied = sum(int((one[0] > 0).sum()) for one in images)
    assert row_gaps(images) == round(gaps / (gaps + occupied), 4)


@pytest.mark.parametrize("height", [1, 2, 24])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_empty_pixels_take_the_next_point_below(height, share):
    given = image(share, height)
    before = given.copy()
    filled = fill_rows(given)
    np.testing.assert_array_equal(given, before)
    for row, column in np.ndindex(given.shape[1:]):
        rows = range(row, min(row + FILLED_ROWS + 1, height))
        source = next((r for r in rows if given[0, r, column] > 0), row)
        np.testing.assert_array_equal(filled[:, row, column], given[:, source, column])


def test_gaps_are_filled_where_training_had_fewer():
    for own, trained, filled in (
        (0.4, 0.1, True),
        (0.15, 0.1, False),
        (0.4, 0.4, False),
        (None, 0.1, False),
        (0.4, None, False),
    ):
        sensors = [replace(SMALL, row_gaps=gaps) for gaps in (own, trained)]
        assert fills_rows(*sensors) is filled
        given = image(0.4)
        expected = fill_rows(given) if filled else given
        np.testing.assert_array_equal(with_filled_gaps(given, *sensors), expected)
