# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import SMALL, make_scan

from salsanext_cli import Scan, project
from salsanext_cli.geometry.intensity import intensity_quantiles, match_intensity
from salsanext_cli.sensors import INTENSITY_LEVELS

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


def test_quantiles_are_the_mean_of_those_of_the_images():
    few, many = (image_of(np.random.default_rng(n).random(1500) ** n, n) for n in (1, 3))
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    each = [np.quantile(image[4][image[0] > 0], levels) for image in (few, many)]
    np.testing.assert_allclose(intensity_quantiles([few, many]), np.mean(each, axis=0), rtol=1e-5)
    assert intensity_quantiles([]) == intensity_quantiles([np.zeros_like(few)]) == ()


def test_few_images_of_another_scale_or_none_do_not_count():
    images = [image_of(np.random.default_rng(n).random(1500)) for n in range(5)]
    bright, none = image_of(255 * np.random.default_rng(9).random(1500)), image_of(np.zeros(1500))
    expected = intensity_quantiles(images)
    assert intensity_quantiles([bright, *images, bright, none, none]) == expected
    assert intensity_quantiles([bright, none]) == intensity_quantiles([bright])
    assert intensity_quantiles([none, none]) == (0.0,) * INTENSITY_LEVELS
    order = np.random.default_rng(0).permutation(5)
    assert intensity_quantiles(images[place] for place in order) == pytest.approx(expected)


def test_decibels_count_all():
    images = [image_of(-40 * np.random.default_rng(n).random(1500) - n) for n in range(3)]
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    each = [np.quantile(image[4][image[0] > 0], levels) for image in images]
    np.testing.assert_allclose(intensity_quantiles(images), np.mean(each, axis=0), rtol=1e-4)


@settings(max_examples=30, deadline=None)
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


@pytest.mark.parametrize("scale", [1 / 255, 255, 65535])
def test_the_scale_does_not_matter(scale):
    random = np.random.default_rng(0).random(1500)
    matched = [
        match_intensity(image, intensity_quantiles([image]), TARGET)
        for image in (image_of(random), image_of(random * scale))
    ]
    np.testing.assert_allclose(*matched, rtol=1e-3, atol=1e-5)
    occupied = matched[0][0] > 0
    found = np.quantile(matched[1][4][occupied], np.linspace(0, 1, INTENSITY_LEVELS))
    np.testing.assert_allclose(found, TARGET, atol=2e-3)


def test_no_intensity_becomes_the_mean():
    image = image_of(np.zeros(1500))
    matched = match_intensity(image, intensity_quantiles([image]), TARGET)
    np.testing.assert_allclose(matched[4][image[0] > 0], np.mean(TARGET), rtol=1e-6)
