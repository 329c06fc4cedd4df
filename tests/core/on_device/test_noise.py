# SPDX-License-Identifier: MIT
"""Noise of images on a device is that of the kernels, with the same random numbers."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch
from devices import on_each_device
from scans import SMALL, make_scan, refused

from salsanext_cli import RangeImage, project
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.row_gaps import with_filled_gaps
from salsanext_cli.core.on_device import noise
from salsanext_cli.core.uncertainty import aleatoric

NOISY = replace(SMALL, range_noise=0.03, intensity_noise=0.1, stds=(9.0, 8.0, 7.0, 0.6, 0.2))
COPIES = 3


@pytest.fixture(scope="module")
def image() -> RangeImage:
    return project(make_scan(2000), NOISY)


@on_each_device
def test_copies_are_those_of_the_kernels(image, device):
    draws = np.stack([*islice(aleatoric.noise_draws(image.channels.shape[1:], 7), COPIES)])
    there = torch.from_numpy(image.channels).to(device)
    found = noise.noisy_copies(there, NOISY, torch.from_numpy(draws).to(device))
    expected = np.stack([*islice(aleatoric.noisy_copies(image, NOISY, 7), COPIES)])
    assert (expected[0] != image.channels).any()
    np.testing.assert_allclose(found.cpu().numpy(), expected, rtol=1e-6, atol=1e-6)


@on_each_device
@pytest.mark.parametrize("gaps", [None, 0.5])
def test_the_variance_of_the_input_is_that_of_the_kernels(image, device, gaps):
    """Also where the gaps between rows are filled."""
    sensor = replace(NOISY, row_gaps=gaps)
    trained = replace(SMALL, row_gaps=0.1)
    there = torch.from_numpy(image.channels).to(device)
    found = noise.input_variance(there, sensor, trained).cpu().numpy()
    filled = with_filled_gaps(image.channels, sensor, trained)
    assert ((filled > 0).sum() > (image.channels > 0).sum()) == (gaps is not None)
    expected = aleatoric.input_variance(filled, sensor)[None]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_sensor_of_unknown_noise_is_refused(image):
    there = torch.from_numpy(image.channels)
    unknown = SMALL.without_noise()
    refused(UsageError, "sensor small", noise.noisy_copies, there, unknown, torch.zeros(1, 2, 1, 1))
    refused(UsageError, "sensor small", noise.input_variance, there, unknown, SMALL)
