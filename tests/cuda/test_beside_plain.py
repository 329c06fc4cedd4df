# SPDX-License-Identifier: MIT
"""On every device the whole network computes what the plain implementation does on the CPU."""

from pathlib import Path

import numpy as np
from devices import on_both
from scans import SMALL, make_scan

from benchmarks.speed import baseline as plain
from salsanext_cli import load_network, project
from salsanext_cli.core.uncertainty.aleatoric import aleatoric


@on_both("float32")
def test_softmax_and_moments(full_weights: Path, device: str, precision: str) -> None:
    image = project(make_scan(4000), SMALL)
    network = load_network(full_weights, device, SMALL, precision, "torch")
    expected = plain.Baseline(full_weights, "cpu", SMALL.to_dict())
    channels = np.where(image.channels[0] > 0, image.channels, np.float32(-1))
    softmax = expected.probabilities(channels)
    np.testing.assert_allclose(network.probabilities(image), softmax, atol=1e-4)
    variance = expected.aleatoric(channels)[1].numpy()
    # On a GPU sums of float32 have another order.
    np.testing.assert_allclose(aleatoric(network, image), variance, rtol=1e-3, atol=1e-9)
