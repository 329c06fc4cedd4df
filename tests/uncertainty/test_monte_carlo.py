# SPDX-License-Identifier: MIT
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan
from shallow import slow_on_openvino

from salsanext_cli import project, sample
from salsanext_cli.geometry.network_input import normalise
from salsanext_cli.network.dropout import ChannelDropout, random_masks, sampling
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.dropout_propagation import propagate_dropout
from salsanext_cli.uncertainty.monte_carlo import pass_seed, torch_batch

SAMPLES = 4


@pytest.fixture(scope="module")
def sampled(network, image):
    return sample(network, image, samples=SAMPLES, seed=5)


def one_pass(network, image, generator):
    """Run the whole network, every dropout replaced by a multiplication written out here."""
    rates = []

    def drop(module, inputs, output):
        (x,) = inputs
        rates.append(module.rate)
        if module.rate == 0:
            return x
        kept = torch.rand(x.shape[1], generator=generator) >= module.rate
        factors = torch.where(kept, 1 / (1 - module.rate), 0.0)
        return x * factors.view(1, -1, 1, 1)

    layers = [m for m in network.module.modules() if isinstance(m, ChannelDropout)]
    handles = [layer.register_forward_hook(drop) for layer in layers]
    with torch.inference_mode():
        logits = network.module(torch.from_numpy(normalise(image.channels, SMALL))[None])
    for handle in handles:
        handle.remove()
    assert len(rates) == len(layers)
    return torch.softmax(logits[0].double(), dim=0).numpy()


def test_against_explicit_passes(network, image, sampled):
    """Mean, variance, entropy and mutual information from a loop over whole passes."""
    passes = np.stack(
        [
            one_pass(network, image, torch.Generator().manual_seed(pass_seed(5, number)))
            for number in range(SAMPLES)
        ]
    )
    mean = passes.mean(axis=0)
    variance = ((passes - mean) ** 2).mean(axis=0).mean(axis=0)
    total = -(mean * np.log(mean)).sum(axis=0)
    expected = -(passes * np.log(passes)).sum(axis=1).mean(axis=0)
    close = {"rtol": 1e-3, "atol": 1e-6}
    np.testing.assert_allclose(sampled.probabilities, mean, **close)
    np.testing.assert_allclose(sampled.uncertainty.epistemic, variance, **close)
    np.testing.assert_allclose(sampled.uncertainty.entropy, total, **close)
    np.testing.assert_allclose(sampled.uncertainty.mutual_information, total - expected, **close)
    assert sampled.uncertainty.epistemic.max() > 1e-3


def test_the_seed_matters_and_neither_order_nor_global_generator(network, image, sampled):
    state = torch.random.get_rng_state()
    sample(network, project(make_scan(seed=9), SMALL), samples=3, seed=1)
    torch.rand(7)
    again = sample(network, image, samples=SAMPLES, seed=5)
    np.testing.assert_array_equal(again.probabilities, sampled.probabilities)
    other = sample(network, image, samples=SAMPLES, seed=6)
    assert (other.probabilities != sampled.probabilities).any()
    torch.random.set_rng_state(state)
    sample(network, image, samples=2, seed=1)
    assert torch.equal(torch.random.get_rng_state(), state)


@slow_on_openvino
@torch.inference_mode()
def test_fewer_passes_at_once_when_memory_is_short(network, image, monkeypatch):
    """As on a GPU, where passes are computed in batches."""
    seeds, module = [pass_seed(5, number) for number in range(4)], network.engine.torch_module
    features = module.trunk(network.engine.tensor(network.input(image.channels)))
    expected = [softmax for softmax, _ in torch_batch(module, features, seeds)]
    sizes, most, rest = [], [1], type(module).rest

    def short_of_memory(module, *features):
        sizes.append(len(features[0]))
        if sizes[-1] > most[0]:
            raise torch.OutOfMemoryError("no room")
        return rest(module, *features)

    monkeypatch.setattr(type(module), "rest", short_of_memory)
    engine = replace(network.engine, load_module=lambda: module)
    function = partial(torch_batch, module, features)
    found = [softmax for softmax, _ in engine.in_batches(function, seeds, 4, "passes")]
    torch.testing.assert_close(found, expected)
    assert sizes == [4, 2, 1, 1, 1, 1]
    most[0] = 0
    with pytest.raises(MemoryError):
        engine.in_batches(function, seeds, 4, "passes")


@slow_on_openvino
def test_the_temperature_is_left_out(network, image, sampled):
    hot = replace(
        network, engine=replace(network.engine, card=replace(network.card, temperature=1e6))
    )
    again = sample(hot, image, samples=SAMPLES, seed=5)
    np.testing.assert_array_equal(again.variance, sampled.variance)
    np.testing.assert_array_equal(
        propagate_dropout(hot, image).variance, propagate_dropout(network, image).variance
    )
    np.testing.assert_array_equal(aleatoric(hot, image), aleatoric(network, image))


def test_sampling_changes_nothing_in_the_network(network, image):
    before = {name: t.clone() for name, t in network.module.state_dict().items()}
    expected = network.probabilities(image)
    sample(network, image, samples=2, seed=0)
    for name, tensor in network.module.state_dict().items():
        assert torch.equal(tensor, before[name]), name
    layers = [*network.module.modules(), *network.engine.torch_module.modules()]
    assert not any(layer.training for layer in layers)
    np.testing.assert_array_equal(network.probabilities(image), expected)


def test_dropout_takes_whole_channels_and_keeps_the_expectation():
    layer = ChannelDropout(0.3)
    generators = [torch.Generator().manual_seed(seed) for seed in range(4000)]
    with sampling(random_masks(generators)):
        dropped = layer(torch.ones(4000, 3, 2, 2))
    assert torch.equal(dropped, dropped[:, :, :1, :1].expand_as(dropped))
    assert dropped.mean().item() == pytest.approx(1, abs=0.02)
    assert (dropped == 0).float().mean().item() == pytest.approx(0.3, abs=0.02)
    assert dropped.max().item() == pytest.approx(1 / 0.7)


def test_dropout_is_off_outside_of_sampling_and_training():
    layer = ChannelDropout(0.5).eval()
    x = torch.ones(1, 8, 2, 2)
    assert torch.equal(layer(x), x)
    with pytest.raises(ZeroDivisionError), sampling(random_masks([torch.Generator()])):
        raise ZeroDivisionError
    assert torch.equal(layer(x), x)
    layer.train()
    torch.manual_seed(0)
    assert not torch.equal(layer(x), x)
