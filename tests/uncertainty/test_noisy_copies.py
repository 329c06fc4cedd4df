# SPDX-License-Identifier: MIT
"""Aleatoric uncertainty by noisy copies of a scan."""

from dataclasses import replace
from itertools import islice

import numpy as np

from salsanext_cli.geometry.network_input import normalise
from salsanext_cli.uncertainty.aleatoric import (
    COPIES,
    input_variance,
    noise_variance,
    noisy_copies,
)


def with_noise(network, metres, intensity):
    sensor = replace(network.sensor, range_noise=metres, intensity_noise=intensity)
    return network.for_sensor(sensor)


def test_copies_have_the_noise_that_density_filtering_begins_with(network, image):
    sensor = with_noise(network, 0.05, 0.02).sensor
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
    hot = replace(network, engine=replace(network.engine, card=card))
    copies = [*islice(noisy_copies(image, network.sensor, 5), COPIES)]
    softmax = np.stack([network.pixel_probabilities([copy], 1.0)[0] for copy in copies])
    found = noise_variance(hot, image, 5)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, softmax.var(axis=0, ddof=1), atol=1e-7)
    assert found.mean(axis=0).std() > 0
    assert not np.array_equal(found, noise_variance(hot, image, 6))
