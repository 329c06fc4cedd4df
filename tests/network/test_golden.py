# SPDX-License-Identifier: MIT
"""Import of the published weights, against outputs of the published implementation."""

import numpy as np
import pytest
import torch

from salsanext_cli.inference.network import load_network
from salsanext_cli.network.weights import read_weights
from salsanext_cli.sensors import sensor
from salsanext_cli.stages.import_weights import import_weights

pytestmark = pytest.mark.real
TOLERANCE = 1e-4


def test_probabilities_are_the_published_ones(golden, tmp_path):
    import_weights(golden / "SalsaNext", tmp_path / "published.safetensors")
    image = torch.from_numpy(np.load(golden / "network_input.npy").astype(np.float32))
    expected = np.load(golden / "network_probabilities_every16th_column.npy")
    with torch.inference_mode():
        logits = load_network(tmp_path / "published.safetensors", "cpu").module(image[None])
    probabilities = torch.softmax(logits, dim=1)[0, :, :, ::16].numpy()
    assert np.abs(probabilities - expected).max() < TOLERANCE
    assert len(np.unique(expected.argmax(0))) > 3


def test_the_published_file_is_imported(golden, tmp_path):
    target = tmp_path / "w.safetensors"
    import_weights(golden / "SalsaNext", target, half=True, dropout=0.1)
    module, card = read_weights(target)
    assert target.stat().st_size < 15e6
    assert card.sensor == sensor("hdl64")
    assert card.architecture == {"name": "salsanext", "class_count": 20, "dropout": 0.1}
    assert "SalsaNext" in card.description
    assert module.bottom.rate == 0.1
