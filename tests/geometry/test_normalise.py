# SPDX-License-Identifier: MIT
"""Normalisation and its variance: closed forms and the published network input."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import Sensor, project, sensor
from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.network_input import noise_of, normalise
from salsanext_cli.uncertainty.aleatoric import input_variance

NOISY = replace(SMALL, range_noise=0.03, intensity_noise=0.1)


@pytest.fixture(scope="module")
def channels():
    return project(make_scan(), SMALL).channels


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
