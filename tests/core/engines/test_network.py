# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Networks on any engine: probabilities, batches, other dropout, merged classes."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan, refused, write_weights
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Scan, label_space, load_network, project, sample
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.geometry.network_input import normalise
from salsanext_cli.core.network.dropout import dropouts, random_masks, sampling
from salsanext_cli.core.uncertainty.monte_carlo import pass_seed
from salsanext_cli.io.weights.loading import load_network, with_dropout


@pytest.fixture(scope="module")
def network(weights):
    return load_network(weights, "cpu")


def test_probabilities_are_the_softmax_of_the_module(network):
    image = project(make_scan(), SMALL)
    probabilities = network.probabilities(image)
    normalised = torch.from_numpy(normalise(image.channels, SMALL))[None]
    with torch.inference_mode():
        logits = network.module(normalised)[0].numpy().astype(np.float64)
    expected = np.exp(logits) / np.exp(logits).sum(axis=0)
    assert probabilities.dtype == np.float32
    np.testing.assert_allclose(probabilities, expected, atol=1e-5)
    np.testing.assert_allclose(network.logits(image), logits, atol=2e-5 * np.abs(logits).max())


@pytest.mark.parametrize("temperature", [0.4, 2.5])
def test_the_temperature_divides_the_logits_and_keeps_the_labels(network, temperature):
    image = project(make_scan(), SMALL)
    tempered = replace(
        network,
        backend=replace(network.backend, card=replace(network.card, temperature=temperature)),
    )
    probabilities = tempered.probabilities(image)
    powers = network.probabilities(image).astype(np.float64) ** (1 / temperature)
    np.testing.assert_allclose(probabilities, powers / powers.sum(axis=0), atol=1e-5)
    before = network.probabilities(image).argmax(axis=0)
    np.testing.assert_array_equal(probabilities.argmax(axis=0), before)


def test_probabilities_are_finite_whatever_the_scan(network):
    for points in (
        np.empty((0, 3), np.float32),
        np.array([[5, 0, 0]], np.float32),
        np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [-np.inf, np.nan, 0]], np.float32),
        np.array([[1e30, 1e30, 1e30], [1e-30, 0, 0]], np.float32),
    ):
        scan = Scan(points, np.full(len(points), np.nan, np.float32))
        probabilities = network.probabilities(project(scan, SMALL))
        assert np.isfinite(probabilities).all()
        np.testing.assert_allclose(probabilities.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize("trained", [0.0, 0.2])
def test_another_dropout_rate_shares_the_weights(tmp_path, trained):
    network = load_network(write_weights(tmp_path / "w.safetensors", dropout=trained), "cpu")
    state = torch.random.get_rng_state()
    other = with_dropout(network, 0.4)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert {layer.rate for layer in dropouts(other.module)} == {0.4}
    assert {layer.rate for layer in dropouts(network.module)} == ({trained} if trained else set())
    assert other.card.architecture == {**network.card.architecture, "dropout": 0.4}
    pairs = zip(other.module.parameters(), network.module.parameters(), strict=True)
    assert all(one.data_ptr() == same.data_ptr() for one, same in pairs)
    image = project(make_scan(), SMALL)
    np.testing.assert_array_equal(other.probabilities(image), network.probabilities(image))


def test_a_network_first_needed_in_inference_can_be_copied(weights):
    network = load_network(weights, "cpu", engine="openvino")
    with torch.inference_mode():
        assert not network.module.training
    assert [layer.rate for layer in dropouts(with_dropout(network, 0.4).module)]


def test_threads_may_share_a_network(weights):
    network = load_network(weights, "cpu", engine="openvino")
    images = [project(make_scan(seed=seed), SMALL) for seed in range(4)]
    expected = [network.probabilities(image) for image in images]
    start = threading.Barrier(4)

    def repeat(number):
        start.wait()
        return [network.probabilities(images[number]) for _ in range(5)]

    with ThreadPoolExecutor(4) as pool:
        for number, found in enumerate(pool.map(repeat, range(4))):
            assert all(np.array_equal(one, expected[number]) for one in found)


def test_weights_that_are_replaced_before_they_are_needed_are_refused(tmp_path):
    """Otherwise the cache would store their graph under the name of the others."""
    path = write_weights(tmp_path / "w.safetensors", seed=11)
    network = load_network(path, "cpu", engine="openvino")
    vars(network.backend).pop("module", None)
    write_weights(path, seed=12)
    with refused(WeightsError, path):
        _ = network.module


COARSE = label_space("coarse")
GROUPS = ClassMerging.between(label_space(), COARSE).groups
ENGINES = pytest.mark.parametrize("engine", ["torch", "openvino"])


@pytest.fixture(scope="module")
def image():
    return project(make_scan(), SMALL)


def summed(values):
    """Add the classes of each group, (C, ...) to (K, ...)."""
    return np.stack([sum(values[i] for i in group) for group in GROUPS])


def both(weights, engine):
    """Return a network in its own classes and in merged ones."""
    own = load_network(weights, "cpu", engine=engine)
    return own, load_network(weights, "cpu", engine=engine, classes=COARSE)


@ENGINES
def test_probabilities_are_added(weights, image, engine):
    own, merged = both(weights, engine)
    assert own.space is own.card.space
    assert merged.space.fits(COARSE)
    assert merged.card.space.fits(own.space)
    found = merged.probabilities(image)
    assert (found.shape, found.dtype) == ((8, 16, 128), np.float32)
    # Torch rounds otherwise from one call to the next.
    np.testing.assert_allclose(found, summed(own.probabilities(image)), atol=1e-5)
    np.testing.assert_allclose(merged.logits(image), own.logits(image), rtol=1e-4, atol=1e-4)
    several = merged.predict([merged.input(image.channels)] * 2)
    assert several[0].softmax is None
    np.testing.assert_array_equal(several[1].labels, found.argmax(axis=0))
    np.testing.assert_allclose(several[1].confidence, found.max(axis=0), atol=1e-5)


@ENGINES
def test_passes_are_added_before_they_are_counted(weights, image, engine):
    """Mean, variance, entropy and mutual information from a loop over sums of every pass."""
    own, merged = both(weights, engine)
    passes = []
    for number in range(4):
        masks = random_masks([torch.Generator().manual_seed(pass_seed(5, number))])
        with torch.inference_mode(), sampling(masks):
            logits = own.module(torch.from_numpy(own.input(image.channels)))
        passes.append(summed(logits.softmax(dim=1)[0].numpy()))
    passes = np.stack(passes).astype(float)
    mean = passes.mean(axis=0)
    entropy = -(mean * np.log(mean)).sum(axis=0)
    of_passes = -(passes * np.log(passes)).sum(axis=1).mean(axis=0)
    found = sample(merged, image, samples=4, seed=5)
    close = {"rtol": 1e-3, "atol": 2e-5}
    np.testing.assert_allclose(found.probabilities, mean, **close)
    np.testing.assert_allclose(found.variance, passes.var(axis=0), **close)
    np.testing.assert_allclose(found.uncertainty.epistemic, passes.var(axis=0).mean(0), **close)
    np.testing.assert_allclose(found.uncertainty.entropy, entropy, **close)
    np.testing.assert_allclose(found.uncertainty.mutual_information, entropy - of_passes, **close)


def test_other_classes_are_refused(weights):
    small = {"labels": {0: "no", 10: "yes"}, "learning_map": {0: 0, 10: 1}}
    space = type(COARSE).from_dict({**small, "learning_map_inv": {0: 0, 1: 10}, "name": "small"})
    with pytest.raises(UsageError) as caught:
        load_network(weights, "cpu", classes=space)
    assert "small" in caught.value.subject
