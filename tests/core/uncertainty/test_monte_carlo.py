# SPDX-License-Identifier: MIT
"""Estimates by dropout and by the noise of the sensor."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import threads
from scans import SMALL, make_scan
from shallow_network import slow_on_openvino

from salsanext_cli import load_network, project, sample
from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.geometry.network_input import normalise
from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.core.uncertainty.monte_carlo import pass_seed

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


@pytest.mark.parametrize("network", ["torch"], indirect=True)
def test_fewer_passes_at_once_when_memory_is_short(network, image, monkeypatch):
    """As on a GPU, where passes are computed in batches."""
    seeds, module = [pass_seed(5, number) for number in range(4)], network.module
    given, size = network.input(image.channels), BatchSize(4, "passes")
    backend = TorchBackend(lambda: module, network.card, network.backend.size)
    expected = backend.sample(given, seeds)
    vars(backend)["_side_by_side"] = size
    sizes, most, rest = [], [1], type(module).rest

    def short_of_memory(module, *features):
        sizes.append(len(features[0]))
        if sizes[-1] > most[0]:
            raise torch.OutOfMemoryError("no room")
        return rest(module, *features)

    monkeypatch.setattr(type(module), "rest", short_of_memory)
    found = backend.sample(given, seeds)
    for one, other in ((found.mean, expected.mean), (found.variance, expected.variance)):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-7)
    assert sizes == [4, 2, 1, 1, 1, 1]
    most[0] = 0
    with pytest.raises(MemoryError):
        backend.sample(given, seeds)


@slow_on_openvino
def test_the_temperature_is_left_out(network, image, sampled):
    card = replace(network.card, temperature=1e6)
    hot = replace(network, backend=replace(network.backend, card=card))
    again = sample(hot, image, samples=SAMPLES, seed=5)
    np.testing.assert_array_equal(again.variance, sampled.variance)
    np.testing.assert_array_equal(aleatoric(hot, image), aleatoric(network, image))


def test_sampling_changes_nothing_in_the_network(network, image):
    before = {name: t.clone() for name, t in network.module.state_dict().items()}
    expected = network.probabilities(image)
    sample(network, image, samples=2, seed=0)
    for name, tensor in network.module.state_dict().items():
        assert torch.equal(tensor, before[name]), name
    layers = [*network.module.modules()]
    assert not any(layer.training for layer in layers)
    np.testing.assert_array_equal(network.probabilities(image), expected)


@slow_on_openvino
def test_shapes_types_and_bounds(network, image):
    found = sample(network, image, samples=4, seed=5)
    assert found.probabilities.shape == found.variance.shape == (20, 16, 128)
    np.testing.assert_allclose(found.probabilities.sum(axis=0), 1, atol=1e-5)
    np.testing.assert_allclose(found.variance.mean(axis=0), found.uncertainty.epistemic, rtol=1e-5)
    assert found.uncertainty.total is None
    for kind, most in (("epistemic", 0.25), ("entropy", np.log(20)), ("mutual_information", 3)):
        values = getattr(found.uncertainty, kind)
        assert values.shape == (16, 128)
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert 0 <= values.min() <= values.max() <= most + 1e-6
    assert (found.uncertainty.mutual_information <= found.uncertainty.entropy).all()


@pytest.mark.parametrize(
    "variance",
    [
        pytest.param(aleatoric, marks=pytest.mark.slow),
        lambda *given: noise_variance(*given, 5),
        lambda *given: sample(*given, samples=4, seed=5).variance,
    ],
    ids=["aleatoric", "copies", "sampling"],
)
def test_no_bit_depends_on_the_number_of_threads(weights, image, variance):
    found = []
    for count in (1, 2, 3):
        with threads(count):
            found.append(variance(load_network(weights, "cpu", engine="openvino"), image))
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])
