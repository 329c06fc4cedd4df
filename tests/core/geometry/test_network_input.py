# SPDX-License-Identifier: MIT
"""Normalisation of the input of a network."""

import numpy as np
import pytest

from salsanext_cli import Sensor, sensor
from salsanext_cli.core.geometry.network_input import normalise


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
