# SPDX-License-Identifier: MIT
import json

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scans import lively
from torch import nn

from salsanext_cli.network.blocks import (
    ContextBlock,
    DilatedStack,
    Down,
    PlainContextBlock,
    StridedDown,
)
from salsanext_cli.network.published import our_name
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.salsanext import SalsaNext
from salsanext_cli.network.up_blocks import (
    AddingUpBlock,
    ReplicatingConvTranspose2d,
    TransposedUnit,
    UpBlock,
)


@pytest.fixture(scope="module")
def network():
    return lively(SalsaNext(class_count=7))


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.real
def test_names_and_shapes_are_those_of_the_published_checkpoint(golden):
    rows = (golden / "salsanext_state_dict.tsv").read_text().splitlines()
    published = {
        our_name(name): tuple(json.loads(shape))
        for name, shape in (row.split("\t") for row in rows)
    }
    ours = {name: tuple(tensor.shape) for name, tensor in SalsaNext().state_dict().items()}
    assert published == ours


@pytest.mark.parametrize("size", [(1, 1), (40, 1800), (5, 4)])
def test_any_size_goes_in_and_comes_out(network, size):
    with torch.inference_mode():
        logits = network(noise(1, 5, *size))
    assert logits.shape == (1, 7, *size)
    assert torch.isfinite(logits).all()


def test_a_batch_gives_what_its_images_give(network):
    images = noise(3, 5, 16, 32)
    with torch.inference_mode():
        together = network(images)
        alone = torch.cat([network(image[None]) for image in images])
    torch.testing.assert_close(together, alone, rtol=1e-4, atol=1e-4)


def test_the_output_depends_on_every_channel(network):
    image = noise(1, 5, 16, 32)
    with torch.inference_mode():
        before = network(image)
        for channel in range(5):
            changed = image.clone()
            changed[:, channel] += 1
            assert not torch.allclose(network(changed), before), channel


@pytest.mark.parametrize(
    ("block", "inputs", "outputs"),
    [
        (ContextBlock(5, 8), (5, 9, 11), (8, 9, 11)),
        (DilatedStack(6, 4), (6, 9, 11), (4, 9, 11)),
        (PlainContextBlock(5, 8), (5, 9, 11), (8, 9, 11)),
        (Down(0.2), (3, 8, 12), (3, 4, 6)),
        (StridedDown(3, 0.2), (3, 8, 12), (3, 4, 6)),
        (TransposedUnit.of_3x3(6, 4), (6, 8, 12), (4, 16, 24)),
        (TransposedUnit.of_2x2(6, 4), (6, 8, 12), (4, 16, 24)),
        (TransposedUnit.replicating(6, 4), (6, 8, 12), (4, 16, 24)),
    ],
)
def test_blocks_keep_or_halve_sizes(block, inputs, outputs):
    assert block(noise(2, *inputs)).shape == (2, *outputs)


@pytest.mark.parametrize(
    "block",
    [
        UpBlock(nn.PixelShuffle(2), 8 // 4 + 3, 5, DilatedStack, 0.2),
        AddingUpBlock(TransposedUnit.of_3x3(8, 3), 3, 5, DilatedStack, 0.2),
    ],
)
def test_an_up_block_doubles_sizes(block):
    assert block(noise(1, 8, 4, 6), noise(1, 3, 8, 12)).shape == (1, 5, 8, 12)


@pytest.mark.parametrize("training", [False, True])
def test_the_first_version_repeats_the_last_row_and_column(training):
    """The published up block: convolution, repetition, LeakyReLU, batch norm, in this order."""
    unit = lively(TransposedUnit.replicating(6, 4)).train(training)
    x = noise(2, 6, 5, 7)
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
