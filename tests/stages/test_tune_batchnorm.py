# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scans import SMALL, make_scan

from salsanext_cli import Scan, load_network, project, read_scan
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import FormatError, WeightsError
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.network.card import read_card
from salsanext_cli.network.weights import NORM_SUFFIXES, read_weights, save_weights
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.tuning import batchnorm
from salsanext_cli.training.tuning.batchnorm import norms

WIDER = replace(SMALL, name="wider", width=192, fov_up=5.0, means=(10.0, 9.0, 0.0, -1.0, 0.3))


@pytest.fixture
def folder(tmp_path):
    """Return scans of one's own, without labels."""
    for number in range(3):
        write_bin(tmp_path / "my scans" / f"{number:06d}.bin", make_scan(1500, number))
    return tmp_path / "my scans"


@pytest.fixture
def weights(narrow_weights):
    return narrow_weights


@pytest.fixture
def network(weights):
    return NetworkSettings(weights, "cpu")


def slow_statistics(network, paths):
    """Return mean and variance of each batch norm over all values of all scans side by side.

    Torch's own batch norm, in training mode, normalises each scan by itself.
    """
    module, values = load_network(network.weights, "cpu").module, {}
    for name, layer in norms(module).items():
        layer.train()
        layer.register_forward_pre_hook(
            lambda _, inputs, name=name: values.setdefault(name, []).append(
                inputs[0][0].detach().flatten(1).double().numpy()
            )
        )
    loaded = network.load()
    for path in paths:
        channels = project(read_scan(path), loaded.sensor).channels
        module(loaded.engine.tensor(loaded.input(channels)))
    together = {name: np.concatenate(parts, axis=1) for name, parts in values.items()}
    return {name: (each.mean(axis=1), each.var(axis=1)) for name, each in together.items()}


def test_the_statistics_of_all_scans_are_stored_and_how_far_they_moved(folder, target, network):
    tuned = tune("batchnorm", folder, target, network=network, share=1.0)
    slow = slow_statistics(network, sorted(folder.iterdir()))
    old, new = load_file(network.weights), load_file(target)
    for moved, (name, (mean, variance)) in zip(tuned["layers"], slow.items(), strict=True):
        was = old[f"{name}.running_mean"].numpy(), old[f"{name}.running_var"].numpy()
        deviation = np.sqrt(variance) + 1e-3
        now = new[f"{name}.running_mean"].numpy(), new[f"{name}.running_var"].numpy()
        np.testing.assert_allclose(now[0] / deviation, mean / deviation, atol=1e-4)
        np.testing.assert_allclose(now[1], variance, rtol=1e-3, atol=1e-6)
        shift = (np.abs(mean - was[0]) / np.sqrt(was[1] + 1e-5)).mean()
        ratio = np.exp(np.log((variance + 1e-5) / (was[1] + 1e-5)).mean())
        assert moved["layer"] == name
        assert moved["shift"] == pytest.approx(shift, rel=1e-3)
        assert moved["variance_ratio"] == pytest.approx(ratio, rel=1e-3)
    assert (tuned["scans"], tuned["share"], tuned["sensor"]) == (3, 1.0, "small")


def test_a_share_of_one_scan_leaves_the_rest_to_the_old(folder, target, network):
    scan = folder / "000000.bin"
    tune("batchnorm", scan, target, network=network, share=0.25)
    old, new = load_file(network.weights), load_file(target)
    # What comes into the first batch norm depends on no other.
    first, values = next(iter(slow_statistics(network, [scan]).items()))
    for suffix, value in zip(NORM_SUFFIXES, values, strict=True):
        expected = 0.75 * old[first + suffix].numpy() + 0.25 * value
        np.testing.assert_allclose(new[first + suffix], expected, rtol=1e-5, atol=1e-6)


def test_the_card_keeps_what_is_still_true(folder, target, weights, tmp_path):
    module, card = read_weights(weights)
    tempered = replace(card, temperature=1.5, scores={"miou": 0.5}, recipe={"name": "quick"})
    source = tmp_path / "source.safetensors"
    save_weights(source, module, tempered)
    tune(
        "batchnorm", folder, target, network=NetworkSettings(source, "cpu", sensor=WIDER), share=0.5
    )
    found = read_card(target)
    said = "random Batch norm re-estimated on 3 scans of wider, share 0.5."
    expected = replace(tempered, scores={}, sensor=WIDER, description=said)
    assert found.to_metadata() == expected.to_metadata()
    # So that nobody has to name the sensor again.
    assert NetworkSettings(target, "cpu").load().sensor == WIDER


def test_scans_that_cannot_be_used(folder, target, network):
    bad = folder / "000002.bin"
    bad.write_bytes(b"half a point")
    with pytest.raises(FormatError, match=r"000002\.bin · "):
        tune("batchnorm", folder, target, network=network)
    write_bin(bad, Scan(np.zeros((3, 3), np.float32), np.zeros(3, np.float32)))
    with pytest.raises(FormatError, match=r"000002\.bin · none of its 3 points has a pixel"):
        tune("batchnorm", folder, target, network=network)
    assert not target.exists()


def test_a_network_without_batch_norm(folder, target, network, monkeypatch):
    monkeypatch.setattr(batchnorm, "norms", lambda _: {})
    with pytest.raises(WeightsError, match=r"\.safetensors · its network has no batch norm"):
        tune("batchnorm", folder, target, network=network)
    assert not target.exists()


def test_a_network_whose_values_overflow(folder, target, network, tmp_path):
    module, card = read_weights(network.weights)
    with torch.no_grad():
        module.get_parameter("stages.1.0.0.weight").mul_(1e25)
    save_weights(tmp_path / "huge.safetensors", module, card)
    with pytest.raises(WeightsError, match=r"000000\.bin · the network's \S+ is not finite"):
        tune(
            "batchnorm",
            folder,
            target,
            network=NetworkSettings(tmp_path / "huge.safetensors", "cpu"),
        )
    assert not target.exists()
