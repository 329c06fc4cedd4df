# SPDX-License-Identifier: MIT
import copy

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, lively, make_scan
from torch import nn

from salsanext_cli import label_space, project
from salsanext_cli.engines.loading import network_of_module
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.registry import build
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.training.tuning.batchnorm import Statistics, norms, statistics_of_scan

SPACE = label_space()


class Normed(SegmentationNetwork):
    """Batch norm of the image, and of the image at a quarter of its size."""

    stride = (4, 4)

    def __init__(self) -> None:
        super().__init__()
        self.norm, self.pool, self.deep = nn.BatchNorm2d(5), nn.AvgPool2d(4), nn.BatchNorm2d(5)
        self.logits = nn.Identity()

    def trunk(self, image):
        return (self.norm(image),)

    def decoded(self, *features):
        self.deep(self.pool(features[0]))
        return features[0]


def network_of(module, sensor=SMALL):
    """Return a random network that computes in float64, so that little rounds."""
    card = WeightsCard({"name": "any"}, SPACE, sensor)
    module = lively(module).double()
    module.register_forward_pre_hook(lambda _, inputs: inputs[0].double())
    return network_of_module(module, card, "cpu")


def image_of(seed=0, sensor=SMALL):
    return project(make_scan(1500, seed), sensor)


def as_when_training(module):
    """Return a copy whose batch norms use and keep the statistics of the batch; dropout is off."""
    module = copy.deepcopy(module).eval()
    for layer in norms(module).values():
        layer.train()
        layer.momentum = 1.0
    return module


@torch.inference_mode()
def inputs_of_norms(module, inputs):
    """Run a network; return what goes into each batch norm, (C, h, w) float64, and its logits."""
    seen = {}
    for name, layer in norms(module).items():
        layer.register_forward_pre_hook(
            lambda _, values, name=name: seen.update({name: values[0][0].double().numpy()})
        )
    return seen, module(inputs).numpy()


def close(found, mean, variance):
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.variance, variance, rtol=1e-9, atol=1e-9)
    assert found.mean.dtype == found.variance.dtype == torch.float64


@pytest.mark.parametrize(
    "module",
    [
        *(build({"name": name, "class_count": 4}) for name in ("salsanext", "salsanet")),
        RangeNet53(4, 0.1, width=4),
    ],
    ids=["salsanext", "salsanet", "rangenet53"],
)
def test_one_scan_has_the_statistics_and_logits_of_batch_norm_in_training(module):
    sensor = SMALL.resized(16, 64)
    network, image = network_of(module, sensor), image_of(0, sensor)
    found = statistics_of_scan(network, image.channels)
    training = as_when_training(module)
    logits = training(network.engine.tensor(network.input(image.channels))).detach().numpy()
    assert list(found) == [name for name, _ in norms(training).items()]
    for name, layer in norms(training).items():
        count = found[name].count
        close(found[name], layer.running_mean, layer.running_var * (count - 1) / count)
    adapted = copy.deepcopy(module)
    for name, layer in norms(adapted).items():
        layer.running_mean.copy_(found[name].mean)
        layer.running_var.copy_(found[name].variance)
    after = network_of_module(adapted, network.card, "cpu").logits(image)
    np.testing.assert_allclose(after, logits[0], rtol=1e-5, atol=1e-5)


def test_empty_pixels_count_and_padding_does_not():
    sensor = SMALL.resized(10, 90)
    network, image = network_of(Normed(), sensor), image_of(0, sensor)
    assert (image.point_of_pixel < 0).mean() > 0.1
    found = statistics_of_scan(network, image.channels)
    channels = network.engine.tensor(network.input(image.channels))[0].double().numpy()
    close(found["norm"], channels.mean(axis=(1, 2)), channels.var(axis=(1, 2)))
    assert found["norm"].count == 900
    training = as_when_training(network.module)
    # Batch norm in training would have counted the padding.
    for name, layer in norms(training).items():
        layer.eval()
        layer.running_mean.copy_(found[name].mean)
        layer.running_var.copy_(found[name].variance)
    values = inputs_of_norms(training, network.engine.tensor(network.input(image.channels)))[0][
        "deep"
    ]
    weights = np.zeros((3, 23))
    for row in range(10):
        for column in range(90):
            weights[row // 4, column // 4] += 1 / 16
    mean = np.average(values, axis=(1, 2), weights=np.broadcast_to(weights, values.shape))
    spread = (values - mean[:, None, None]) ** 2
    variance = np.average(spread, axis=(1, 2), weights=np.broadcast_to(weights, values.shape))
    close(found["deep"], mean, variance)


def pooled(parts):
    total = None
    for part in parts:
        values = torch.from_numpy(part)[None, None]
        new = Statistics.of(values, torch.ones(values.shape[1:], dtype=torch.float64))
        total = new if total is None else total + new
    return total


@given(
    st.lists(st.integers(1, 9), min_size=1, max_size=6),
    st.floats(-1e6, 1e6),
    st.sampled_from([0.0, 1e-3, 1.0, 1e3]),
    st.integers(0, 2**32),
)
def test_pooling_is_the_same_as_having_all_at_once_in_any_order(sizes, offset, spread, seed):
    random = np.random.default_rng(seed)
    parts = [offset + random.normal(0, spread, size) for size in sizes]
    together = np.concatenate(parts)
    for order in (range(len(parts)), random.permutation(len(parts))):
        found = pooled([parts[i] for i in order])
        assert found.count == len(together)
        np.testing.assert_allclose(found.mean[0], together.mean(), rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(found.variance[0], together.var(), rtol=1e-6, atol=1e-12)
