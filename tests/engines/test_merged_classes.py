# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Networks whose classes are merged: the same sums by every engine and in every estimate."""

import numpy as np
import pytest
import torch
from scans import SMALL, make_scan
from shallow import shallow, weights  # noqa: F401

from salsanext_cli import label_space, load_network, project, sample
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.errors import UsageError
from salsanext_cli.uncertainty.adf import softmax_moments
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.dropout_propagation import propagate_dropout
from salsanext_cli.uncertainty.monte_carlo import pass_seed, torch_passes

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
    several = merged.pixel_probabilities([image.channels] * 2)
    np.testing.assert_allclose(several[1], found, atol=1e-5)


@ENGINES
def test_passes_are_added_before_they_are_counted(weights, image, engine):
    """Mean, variance, entropy and mutual information from a loop over sums of every pass."""
    own, merged = both(weights, engine)
    with torch.inference_mode():
        seeds = [pass_seed(5, number) for number in range(4)]
        drawn = torch_passes(own.engine, own.input(image.channels), seeds)
        passes = np.stack([summed(softmax) for softmax, _ in drawn]).astype(float)
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


@pytest.mark.parametrize("estimate", [aleatoric, lambda *given: propagate_dropout(*given).variance])
def test_moments_have_a_variance_of_each_merged_class_alike_by_both_engines(
    weights, image, estimate
):
    found = [estimate(both(weights, engine)[1], image) for engine in ("torch", "openvino")]
    assert found[0].shape == (8, 16, 128)
    assert found[0].min() >= 0
    assert found[0].max() <= 0.25
    np.testing.assert_allclose(found[1], found[0], rtol=2e-3, atol=1e-6)


def test_groups_of_one_class_change_nothing_and_empty_ones_are_impossible():
    logits = torch.from_numpy(np.random.default_rng(1).normal(0, 3, (5, 50)))
    spread = logits.abs()
    plain = softmax_moments(logits, spread, 0)
    found = softmax_moments(logits, spread, 0, [[0], [], [1], [2], [3], [4]])
    for expected, values in zip(plain, found, strict=True):
        np.testing.assert_allclose(np.delete(values.numpy(), 1, 0), expected, rtol=1e-9)
        assert not values[1].any()
    mean, variance = softmax_moments(logits, spread, 0, [[], range(5)])
    np.testing.assert_allclose(mean, [[0] * 50, [1] * 50], atol=1e-12)
    assert not variance.any()


def test_other_classes_are_refused(weights):
    small = {"labels": {0: "no", 10: "yes"}, "learning_map": {0: 0, 10: 1}}
    space = type(COARSE).from_dict({**small, "learning_map_inv": {0: 0, 1: 10}, "name": "small"})
    with pytest.raises(UsageError, match="label space small · no raw id 1"):
        load_network(weights, "cpu", classes=space)
