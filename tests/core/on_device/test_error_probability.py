# SPDX-License-Identifier: MIT
"""Features and probabilities of errors are those of the kernels, but for the order of sums."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import on_each_device
from error_models import layers
from scans import SMALL

from salsanext_cli import label_space, project
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device import error_probability as on_device
from salsanext_cli.core.on_device.projection import project as project_batch
from salsanext_cli.core.on_device.regions import ROUNDS, Regions
from salsanext_cli.core.uncertainty.error_features import FEATURES, error_features

CLASSES = 4


@pytest.fixture
def described(batch_of, scans, sensors):
    """Return a batch, its softmax (B, C, H, W) and random labels of its points."""
    batch = batch_of(scans, sensors)
    random = np.random.default_rng(5)
    size = (len(scans), CLASSES, SMALL.height, SMALL.width)
    # Rounded values make ties, patches make regions.
    powers = np.exp(random.normal(scale=2, size=size).round(1))[..., ::3].repeat(3, -1)
    powers = powers[..., : SMALL.width]
    softmax = (powers / powers.sum(axis=1, keepdims=True)).astype(np.float32)
    labels = random.integers(0, CLASSES, len(batch.points)).astype(np.uint8)
    return batch, softmax, labels


def single_images(batch, scans):
    return [project(*pair) for pair in zip(scans, batch.sensors, strict=True)]


@on_each_device
def test_features_are_those_of_single_scans(described, scans):
    batch, softmax, labels = described
    images = project_batch(batch)
    on_its_device = torch.from_numpy(softmax).to(batch.points.device)
    labelled = on_device.LabelledImages.from_softmax(images, on_its_device)
    all_labels = torch.from_numpy(labels).to(batch.points.device).long()
    regions = Regions.from_classes(labelled.classes, ROUNDS)
    found = on_device.error_features(labelled, all_labels, regions).cpu().split(batch.counts)
    labels_of_scans = np.split(labels, np.cumsum(batch.counts)[:-1])
    for number, image in enumerate(single_images(batch, scans)):
        expected = error_features(image, softmax[number], labels_of_scans[number])
        np.testing.assert_allclose(found[number], expected, rtol=1e-5, atol=1e-6)


@on_each_device
@pytest.mark.parametrize("temperature", [None, 1.3, 0.5])
def test_the_probability_is_that_of_the_model(described, scans, temperature):
    batch, softmax, labels = described
    model = ErrorModel(features=FEATURES, layers=layers(9, 6, 3, 1), temperature=temperature)
    card = WeightsCard({}, label_space(), SMALL, temperature=1.3, error=model)
    device = batch.points.device
    found = on_device.error_probability(
        project_batch(batch),
        torch.from_numpy(softmax).to(device),
        torch.from_numpy(labels).to(device),
        card,
    )
    exponent = 1.3 / (temperature or 1.3)
    powers = softmax.astype(np.float64) ** exponent
    scaled = (powers / powers.sum(axis=1, keepdims=True)).astype(np.float32)
    labels_of_scans = np.split(labels, np.cumsum(batch.counts)[:-1])
    expected = [
        model.probability(error_features(image, *pair))
        for image, *pair in zip(single_images(batch, scans), scaled, labels_of_scans, strict=True)
    ]
    probability = found.probability.cpu().numpy()
    np.testing.assert_allclose(probability, np.concatenate(expected), rtol=1e-3, atol=1e-5)
    assert found.is_final.all()


@on_each_device
def test_weights_without_a_model_are_an_error_of_the_caller(described):
    batch, softmax, labels = described
    card = replace(WeightsCard({}, label_space(), SMALL), error=None)
    with pytest.raises(ValueError, match="no error model"):
        on_device.error_probability(project_batch(batch), softmax, labels, card)
