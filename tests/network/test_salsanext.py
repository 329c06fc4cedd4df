# SPDX-License-Identifier: MIT
import json

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scans import lively

from salsanext_cli.network.blocks import ReplicatingConvTranspose2d, transposed_unit
from salsanext_cli.network.published import our_name
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.salsanext import SalsaNext


@pytest.fixture(scope="module")
def network():
    return lively(SalsaNext(class_count=7))


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
