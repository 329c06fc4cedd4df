# SPDX-License-Identifier: MIT
"""Aleatoric uncertainty: the variance of the input, noisy copies of a scan, one pass."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scans import SMALL, refused
from shallow_network import slow_on_openvino

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.network_input import normalise
from salsanext_cli.core.uncertainty.aleatoric import (
    COPIES,
    aleatoric,
    input_variance,
    noise_variance,
    noisy_copies,
)

NOISY = replace(SMALL, range_noise=0.03, intensity_noise=0.1)


def test_the_variance_is_that_of_copies_shifted_along_their_rays(image):
    """The input is linear in either error, so one standard deviation of each shows both."""
    channels = image.channels
    shifted = channels * (1 + 0.03 / np.maximum(channels[:1], 1e-3))
    shifted[4] = channels[4] + 0.1
    difference = normalise(shifted, NOISY) - normalise(channels, NOISY)
    variance = input_variance(channels, NOISY)
    assert variance.dtype == np.float32
    occupied = channels[0] > 0
    assert 0.1 < occupied.mean() < 0.9
    found, expected = variance[:, occupied], difference[:, occupied].astype(np.float64) ** 2
    np.testing.assert_allclose(found, expected, rtol=2e-2, atol=1e-10)
    assert not variance[:, ~occupied].any()
    assert not input_variance(channels, replace(NOISY, range_noise=0.0, intensity_noise=0.0)).any()


@pytest.mark.parametrize("missing", ["range_noise", "intensity_noise"])
def test_a_sensor_that_does_not_know_its_noise(image, missing):
    with refused(UsageError, "sensor small"):
        input_variance(image.channels, replace(NOISY, **{missing: None}))


def softmax_of(network, channels):
    (prediction,) = network.predict([network.input(channels)], softmax=True)
    return prediction.softmax


@slow_on_openvino
def test_it_ranks_pixels_as_noisy_copies_do(network, image):
    """Sixty-four copies of the scan, each with its own noise of 2 cm and 0.02."""
    occupied = image.channels[0] > 0
    copies = islice(noisy_copies(image, network.sensor, 0), 64)
    passes = [softmax_of(network, copy) for copy in copies]
    sampled = np.var(passes, axis=0).mean(axis=0)[occupied]
    propagated = aleatoric(network, image).mean(axis=0)[occupied]
    ranks = (np.argsort(np.argsort(values)) for values in (sampled, propagated))
    assert np.corrcoef(*ranks)[0, 1] > 0.6


def test_copies_have_the_noise_that_density_filtering_begins_with(network, image):
    sensor = replace(network.sensor, range_noise=0.05, intensity_noise=0.02)
    copies = np.stack([*islice(noisy_copies(image, sensor, 3), 400)])
    given = np.stack([normalise(copy, sensor) for copy in copies])
    occupied = image.channels[0] > 0
    expected = input_variance(image.channels, sensor)[:, occupied]
    np.testing.assert_allclose(given.var(axis=0)[:, occupied].mean(1), expected.mean(1), rtol=0.01)
    offsets = (copies - image.channels)[:, :, occupied]
    along = offsets[:, 1:4] * image.channels[1:4, occupied] / image.channels[0, occupied]
    np.testing.assert_allclose(along.sum(axis=1), offsets[:, 0], atol=1e-4)
    assert not copies[:, :, ~occupied].any()


def test_the_variance_is_that_of_the_plain_softmax_of_the_copies(network, image):
    card = replace(network.card, temperature=3.0)
    hot = replace(network, backend=replace(network.backend, card=card))
    copies = [*islice(noisy_copies(image, network.sensor, 5), COPIES)]
    softmax = np.stack([softmax_of(network, copy) for copy in copies])
    found = noise_variance(hot, image, 5)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, softmax.var(axis=0, ddof=1), atol=1e-7)
    assert found.mean(axis=0).std() > 0
    assert not np.array_equal(found, noise_variance(hot, image, 6))
