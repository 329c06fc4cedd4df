# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.noise import input_variance, noise_of
from salsanext_cli.geometry.normalise import normalise
from salsanext_cli.geometry.projection import project

NOISY = replace(SMALL, range_noise=0.03, intensity_noise=0.1)


@pytest.fixture(scope="module")
def channels():
    return project(make_scan(), SMALL).channels


def test_against_copies_that_are_shifted_along_their_rays(channels):
    """The input is linear in either error, so one standard deviation of each shows both."""
    shifted = channels * (1 + 0.03 / np.maximum(channels[:1], 1e-3))
    shifted[4] = channels[4] + 0.1
    difference = normalise(shifted, NOISY) - normalise(channels, NOISY)
    variance = input_variance(channels, NOISY)
    assert variance.dtype == np.float32
    occupied = channels[0] > 0
    assert 0.1 < occupied.mean() < 0.9
    found, expected = variance[:, occupied], difference[:, occupied].astype(np.float64) ** 2
    np.testing.assert_allclose(found, expected, rtol=2e-2, atol=1e-10)


def test_empty_pixels_and_perfect_sensors_are_certain(channels):
    assert not input_variance(channels, NOISY)[:, channels[0] <= 0].any()
    perfect = replace(SMALL, range_noise=0.0, intensity_noise=0.0)
    assert not input_variance(channels, perfect).any()


@pytest.mark.parametrize("missing", ["range_noise", "intensity_noise"])
def test_a_sensor_that_does_not_know_its_noise(channels, missing):
    silent = replace(NOISY, **{missing: None})
    with pytest.raises(UsageError, match="sensor small · its noise is not known"):
        input_variance(channels, silent)
    assert noise_of(NOISY) == (0.03, 0.1)
