# SPDX-License-Identifier: MIT
"""Receptive fields that are recorded, against gradients."""

from dataclasses import replace

import pytest
import torch

from salsanext_cli.network import designs
from salsanext_cli.network.complexity import RECEPTIVE_FIELDS
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.salsanext import SalsaNext

DESIGNS = {
    "salsanext": designs.SALSANEXT,
    "salsanext-v1": designs.V1_POOLING,
    "salsanet": designs.SALSANET,
    "salsanet-context": designs.SALSANET_CONTEXT,
    "salsanet-dropout": designs.SALSANET_DROPOUT,
    "salsanet-pooling": designs.SALSANET_POOLING,
    "salsanet-dilated": designs.SALSANET_DILATED,
    "salsanext-v1-layers": designs.V1_LAYERS,
    "salsanext-v1-context": designs.V1_CONTEXT,
    "salsanext-v1-dropout": designs.V1_DROPOUT,
}


def narrow(design):
    """Return a network of four channels, whose receptive field is the same."""
    widths, ups = (tuple(4 for _ in many) for many in (design.widths, design.decoder_widths))
    return SalsaNext(1, 0.0, replace(design, widths=widths, decoder_widths=ups))


def extent(module, axis):
    """Return the longest span of the image that a pixel of a middle cell has gradients for."""
    for values in module.parameters():
        # All positive, so that nothing cancels.
        torch.nn.init.constant_(values, 1 / values[0].numel())
    # Two lines at the coarsest level: the taps of a 2×2 window, dilated, lie both outside of one.
    size = [max(4, 2 * step) for step in module.stride]
    size[axis] = 1024
    image = torch.ones(1, 5, *size, dtype=torch.float64, requires_grad=True)
    lines = module.double().eval()(image)[0, 0].movedim(axis, 0)[:, 2]
    spans = []
    for place in range(512, 512 + module.stride[axis]):
        (gradient,) = torch.autograd.grad(lines[place], image, retain_graph=True)
        found = gradient[0].sum(dim=(0, 2 - axis)).nonzero().flatten()
        spans.append(int(found[-1] - found[0]) + 1)
    return max(spans)


@pytest.mark.parametrize("name", DESIGNS)
def test_it_is_where_gradients_are_not_zero(name, monkeypatch):
    monkeypatch.setattr("salsanext_cli.network.salsanext.CONTEXT_WIDTH", 4)
    side = extent(narrow(DESIGNS[name]), axis=0)
    assert RECEPTIVE_FIELDS[name] == (side, side)


@pytest.mark.parametrize("axis", [0, 1])
def test_of_rangenet53(axis):
    assert extent(RangeNet53(1, width=2), axis) == RECEPTIVE_FIELDS["rangenet53"][axis]


def test_every_network_has_one_and_twins_the_same():
    assert list(RECEPTIVE_FIELDS) == list(ARCHITECTURES)
    assert RECEPTIVE_FIELDS["salsanet-shuffle"] == RECEPTIVE_FIELDS["salsanext"]
    assert RECEPTIVE_FIELDS["salsanext-v1-pooling"] == RECEPTIVE_FIELDS["salsanext-v1"]
