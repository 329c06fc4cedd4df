# SPDX-License-Identifier: MIT
"""Against outputs of the published implementation."""

import numpy as np
import pytest
import torch

from salsanext_cli.inference.network import load_network
from salsanext_cli.stages.import_weights import import_weights

pytestmark = pytest.mark.real
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def imported(golden, tmp_path_factory):
    target = tmp_path_factory.mktemp("imported") / "published.safetensors"
    card = import_weights(golden / "SalsaNext", target)
    assert card.space.class_count == 20
    return target


@pytest.fixture(scope="module")
def published(golden):
    """Load the network's input, normalised already, and every 16th column of its softmax."""
    image = np.load(golden / "network_input.npy").astype(np.float32)
    return image, np.load(golden / "network_probabilities_every16th_column.npy")


def test_probabilities_are_the_published_ones(imported, published):
    image, expected = published
    with torch.inference_mode():
        logits = load_network(imported, "cpu").module(torch.from_numpy(image)[None])
    probabilities = torch.softmax(logits, dim=1)[0, :, :, ::16].numpy()
    assert np.abs(probabilities - expected).max() < TOLERANCE
    assert len(np.unique(expected.argmax(0))) > 3
