# SPDX-License-Identifier: MIT
"""Behaviour that every network of the registry must have; SalsaNext as published."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from architectures import EACH
from scans import SMALL, lively, make_scan

from salsanext_cli import label_space, project, sample
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.torch_backend import TorchBackend
from salsanext_cli.network.blocks import ReplicatingConvTranspose2d, transposed_unit
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.dropout import dropouts, random_masks, sampling
from salsanext_cli.network.published import our_name
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

TWINS = {"salsanet-shuffle": "salsanext", "salsanext-v1-pooling": "salsanext-v1"}
"""Rungs of the same network as another's, which only the loss tells apart."""
DIFFERENT = [each for each in EACH if each.values[0] not in TWINS]
SPACE = label_space()


def network(name):
    """Return a network of random weights that has seen training."""
    card = WeightsCard(architecture(name), SPACE, SMALL)
    # What the engine has in memory goes with the network; the largest has a gigabyte.
    size = (SMALL.height, SMALL.width)
    return Network(TorchBackend(lambda: trained(name), card, size), SMALL)


def architecture(name):
    return {"name": name, "class_count": SPACE.class_count, "dropout": 0.2}


@cache
def trained(name):
    # What is made in inference mode could not be given to another module later.
    with torch.random.fork_rng([]), torch.inference_mode(False):
        torch.manual_seed(0)
        module = lively(build(architecture(name)))
    if name == "rangenet53":
        # Dozens of residual blocks would make logits of 100 000, which training never does.
        for key, values in module.state_dict().items():
            if key.endswith("wide.1.weight"):
                values.fill_(0.1)
    return module


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def image():
    return project(make_scan(), replace(SMALL, width=32))


@pytest.mark.parametrize("name", DIFFERENT)
@torch.inference_mode()
def test_odd_sizes(name):
    module = network(name).module
    logits = module(noise(1, 5, 9, 37))
    assert logits.shape == (1, 20, 9, 37)
    assert torch.isfinite(logits).all()
    assert logits.std() > 0


@pytest.mark.parametrize("name", DIFFERENT)
@torch.inference_mode()
def test_nothing_drops_in_the_trunk_and_something_right_after_it(name):
    module, image = network(name).module, noise(1, 5, 32, 32)
    features = module.trunk(image)
    assert torch.equal(module.rest(*features), module(image))
    with sampling(random_masks([torch.Generator().manual_seed(1)])):
        for sampled, certain in zip(module.trunk(image), features, strict=True):
            assert torch.equal(sampled, certain)
        whole = module(image)
    with sampling(random_masks([torch.Generator().manual_seed(1)])):
        assert torch.equal(module.rest(*features), whole)
    assert not torch.equal(module.rest(*features), whole)


@pytest.mark.parametrize("name", DIFFERENT)
def test_a_step_of_training_reaches_every_parameter(name):
    module = build({"name": name, "class_count": 20, "dropout": 0.0})
    recipe = Recipe(architecture=name, optimiser="sgd")
    learner = Learner(module, recipe, torch.ones(20), torch.device("cpu"))
    # Below 17 rows the coarsest level is one, which a dilated 2×2 window steps over.
    truth = torch.from_numpy(np.random.default_rng(0).integers(0, 20, (2, 20, 40), np.uint8))
    loss = learner.step(noise(2, 5, 20, 40), truth, 0, 1)
    assert np.isfinite(loss.item())
    lost = [key for key, p in module.named_parameters() if p.grad is None or not p.grad.any()]
    assert lost == []


@pytest.mark.parametrize("name", DIFFERENT)
def test_sampled_dropout(name, image):
    first, other = (sample(network(name), image, samples=2, seed=seed) for seed in (0, 1))
    assert not np.array_equal(first.variance, other.variance)
    assert np.isfinite(first.variance).all()
    assert first.uncertainty.epistemic.min() >= 0
    assert first.uncertainty.epistemic.max() > 0


@pytest.mark.parametrize(
    ("name", "momentum", "rate"), [("rangenet53", 0.01, 0.01), ("salsanet", 0.1, 0.2)]
)
def test_momentum_of_batch_norm_and_default_rate_are_the_authors(name, momentum, rate):
    module = build({"name": name})
    norms = [m for m in module.modules() if isinstance(m, torch.nn.BatchNorm2d)]
    assert {norm.momentum for norm in norms} == {momentum}
    assert {layer.rate for layer in dropouts(module)} == {rate}


@pytest.mark.real
def test_names_and_shapes_are_those_of_the_published_checkpoint(golden):
    rows = (golden / "salsanext_state_dict.tsv").read_text().splitlines()
    published = {
        our_name(name): tuple(json.loads(shape))
        for name, shape in (row.split("\t") for row in rows)
    }
    ours = {name: tuple(tensor.shape) for name, tensor in SalsaNext().state_dict().items()}
    assert published == ours


@pytest.mark.parametrize("training", [False, True])
def test_the_first_version_repeats_the_last_row_and_column(training):
    """The published up block: convolution, repetition, LeakyReLU, batch norm, in this order."""
    unit = lively(transposed_unit(ReplicatingConvTranspose2d(6, 4))).train(training)
    x = torch.randn(2, 6, 5, 7)
    convolution, _, norm = unit
    short = F.conv_transpose2d(x, convolution.weight, convolution.bias, stride=2, padding=1)
    assert short.shape == (2, 4, 9, 13)
    edges = np.pad(short.detach().numpy(), ((0, 0), (0, 0), (0, 1), (0, 1)), mode="edge")
    bent = np.where(edges > 0, edges, 0.01 * edges)
    mean, variance = norm.running_mean.numpy(), norm.running_var.numpy()
    if training:
        mean, variance = bent.mean(axis=(0, 2, 3)), bent.var(axis=(0, 2, 3))
    scale, shift = (p.detach().numpy()[:, None, None] for p in (norm.weight, norm.bias))
    mean, variance = mean[:, None, None].copy(), variance[:, None, None].copy()
    expected = (bent - mean) / np.sqrt(variance + norm.eps) * scale + shift
    np.testing.assert_allclose(unit(x).detach().numpy(), expected, rtol=1e-4, atol=1e-5)


def test_every_rung_of_the_first_version_repeats_and_no_other_does():
    def repeats(name):
        with torch.device("meta"):
            modules = build({"name": name}).modules()
        return any(isinstance(module, ReplicatingConvTranspose2d) for module in modules)

    assert {name for name in ARCHITECTURES if repeats(name)} == {
        name for name in ARCHITECTURES if name.startswith("salsanext-v1")
    }


def test_dropout_rates_and_their_places():
    """Blocks 2 to 5 and up blocks 1 to 3 drop; the first and the last do not."""
    rates = {
        name: module.rate
        for name, module in SalsaNext(dropout=0.3).named_modules()
        if hasattr(module, "rate")
    }
    off = {name.split(".")[0] for name, rate in rates.items() if rate == 0}
    on = {name.split(".")[0] for name, rate in rates.items() if rate == 0.3}
    assert off == {"down1", "up4"}
    assert on == {"down2", "down3", "down4", "bottom", "up1", "up2", "up3"}
    assert len(rates) == 5 + 3 * 4
