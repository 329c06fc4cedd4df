# SPDX-License-Identifier: MIT
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from salsanext_cli.errors import UsageError
from salsanext_cli.uncertainty.aleatoric import aleatoric, noisy_copies


def with_noise(network, metres, intensity):
    sensor = replace(network.sensor, range_noise=metres, intensity_noise=intensity)
    return network.for_sensor(sensor)


def test_a_sensor_of_unknown_noise(network, image):
    with pytest.raises(UsageError, match="its noise is not known"):
        aleatoric(with_noise(network, None, 0.02), image)


def test_it_ranks_pixels_as_noisy_copies_do(network, image):
    """Sixty-four copies of the scan, each with its own noise of 2 cm and 0.02."""
    occupied = image.channels[0] > 0
    copies = islice(noisy_copies(image, network.sensor, 0), 64)
    passes = [network.pixel_probabilities([copy])[0] for copy in copies]
    sampled = np.var(passes, axis=0).mean(axis=0)[occupied]
    propagated = aleatoric(network, image).mean(axis=0)[occupied]
    ranks = (np.argsort(np.argsort(values)) for values in (sampled, propagated))
    assert np.corrcoef(*ranks)[0, 1] > 0.6
