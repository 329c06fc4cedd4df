# SPDX-License-Identifier: MIT
"""Winograd's convolution against torch's, and its pieces against their matrices."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from salsanext_cli.inference import lanes
from salsanext_cli.inference.fused import fuse
from salsanext_cli.inference.winograd import TILE, Tiling, corner, from_products, to_products
from salsanext_cli.kernels import compiled

INPUT_TRANSFORM = [
    [4, 0, -5, 0, 1, 0],
    [0, -4, -4, 1, 1, 0],
    [0, 4, -4, -1, 1, 0],
    [0, -2, -1, 2, 1, 0],
    [0, 2, -1, -2, 1, 0],
    [0, 4, 0, -5, 0, 1],
]
OUTPUT_TRANSFORM = [
    [1, 1, 1, 1, 1, 0],
    [0, 1, -1, 2, -2, 0],
    [0, 1, 1, 4, 4, 0],
    [0, 1, -1, 8, -8, 1],
]


@compiled
def arithmetic(x, y, slope):
    a, b = lanes.load(x, 1), lanes.load(x, 17)
    lanes.store(y, 2, lanes.leaky(a * b - lanes.splat(slope), lanes.splat(slope)) + b)


def test_lanes_are_sixteen_numbers():
    x = np.random.default_rng(0).normal(size=40).astype(np.float32)
    y = np.zeros(20, np.float32)
    arithmetic(x, y, np.float32(0.25))
    a, b = x[1:17], x[17:33]
    bent = np.where(a * b > 0.25, a * b - 0.25, (a * b - 0.25) / 4)
    np.testing.assert_allclose(y[2:18], bent + b, rtol=1e-6, atol=1e-7)
    assert y[:2].tolist() == y[18:].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("kernel", "matrix"), [(to_products, INPUT_TRANSFORM), (from_products, OUTPUT_TRANSFORM)]
)
def test_transforms_are_their_matrices(kernel, matrix):
    rows = np.random.default_rng(1).integers(-9, 9, (6, 16)).astype(np.float32)
    out = np.zeros((len(matrix), 16), np.float32)
    kernel(rows.ravel(), 0, 16, out.reshape(-1), 0, 16)
    np.testing.assert_array_equal(out, np.array(matrix) @ rows)


@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 2]))
def test_tiles_cover_every_pixel_once(height, width, dilation):
    visits = np.zeros((height + 16, width + 16), int)
    tiling = Tiling(height, width, dilation)
    for tile in range(tiling.count):
        top, left = corner(tile, dilation, *tiling.numbers[3:])
        reach = TILE * dilation
        visits[top : top + reach : dilation, left : left + reach : dilation] += 1
    assert (visits[:height, :width] == 1).all()


class OneLayer(nn.Module):
    """A layer, or several, in a module that `fuse` takes."""

    def __init__(self, *layers):
        super().__init__()
        self.layers = nn.Sequential(*layers)

    def forward(self, x):
        return self.layers(x)


def close_to_float64(module, x):
    """Compare the fused module with the module in float64, relative to its largest output."""
    module.eval()
    with torch.inference_mode():
        found = fuse(module)(x)
        expected = module.double()(x.double())
    error = (found.double() - expected).abs().max() / expected.abs().max()
    assert error < 2e-5


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([(3, 1, 1), (3, 2, 2), (2, 2, 1), (1, 1, 0)]),
    st.tuples(st.integers(1, 3), st.integers(1, 21), st.integers(1, 70)),
    st.sampled_from([16, 48]),
    st.sampled_from([16, 32]),
    st.sampled_from(["conv", "conv, leaky", "conv, leaky, norm", "conv, norm, leaky"]),
    st.integers(0, 99),
)
def test_every_kind_of_unit(geometry, size, inputs, outputs, kinds, seed):
    generator = torch.Generator().manual_seed(seed)
    kernel, dilation, padding = geometry
    norm = nn.BatchNorm2d(outputs)
    norm.running_mean.normal_(generator=generator)
    norm.running_var.uniform_(0.1, 2, generator=generator)
    norm.weight.data.normal_(generator=generator)
    norm.bias.data.normal_(generator=generator)
    convolution = nn.Conv2d(inputs, outputs, kernel, dilation=dilation, padding=padding)
    layers = {"conv": convolution, "leaky": nn.LeakyReLU(0.1), "norm": norm}
    module = OneLayer(*(layers[kind] for kind in kinds.split(", ")))
    assert not [m for m in fuse(module).modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    batch, height, width = size
    close_to_float64(module, torch.randn(batch, inputs, height, width, generator=generator))


@pytest.mark.parametrize(
    "layer",
    [
        nn.Conv2d(5, 16, 3, padding=1),
        nn.Conv2d(16, 20, 3, padding=1),
        nn.Conv2d(16, 16, 3, padding=2),
        nn.Conv2d(16, 16, 3, padding=1, stride=2),
        nn.Conv2d(16, 16, 3, padding=1, groups=2),
        nn.Conv2d(16, 16, 3, padding=1, padding_mode="circular"),
        nn.Conv2d(16, 16, 5, padding=2),
        nn.ConvTranspose2d(16, 16, 3, stride=2),
    ],
    ids=str,
)
def test_other_layers_stay_as_they_are(layer):
    module = OneLayer(layer).eval()
    x = torch.randn(2, layer.in_channels, 8, 12)
    with torch.inference_mode():
        torch.testing.assert_close(fuse(module)(x), module(x))


def test_values_that_are_not_finite_stay_in_their_tiles():
    module = OneLayer(nn.Conv2d(16, 16, 3, padding=1)).eval()
    x = torch.zeros(1, 16, 16, 16)
    x[0, 0, 8, 8] = torch.nan
    with torch.inference_mode():
        found = fuse(module)(x)
    assert found[0, :, 7:10, 7:10].isnan().all()
    assert found[0, :, :4].isfinite().all()


def test_some_channels_of_a_larger_tensor():
    module = OneLayer(nn.Conv2d(16, 16, 3, padding=1)).eval()
    wide = torch.randn(2, 9, 11, 48).permute(0, 3, 1, 2)
    with torch.inference_mode():
        step = fuse(module).layers
        target = torch.zeros(2, 9, 11, 48).permute(0, 3, 1, 2)
        step(wide[:, 16:32], target[:, 32:])
        expected = F.conv2d(
            wide[:, 16:32], module.layers[0].weight, module.layers[0].bias, padding=1
        )
    torch.testing.assert_close(target[:, 32:], expected, rtol=1e-4, atol=1e-4)
    assert not target[:, :32].any()
