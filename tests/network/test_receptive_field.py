# SPDX-License-Identifier: MIT
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from salsanext_cli.network import designs
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.receptive_field import Dependence, receptive_field
from salsanext_cli.network.salsanext import SalsaNext


def narrow(design):
    """Return a network that reaches as far with four channels."""
    widths, raised = (tuple(4 for _ in many) for many in (design.widths, design.decoder_widths))
    return SalsaNext(1, 0.0, replace(design, widths=widths, decoder_widths=raised))


NETWORKS = {
    "salsanext": lambda: narrow(designs.SALSANEXT),
    "salsanet": lambda: narrow(designs.SALSANET),
    "salsanet-dilated": lambda: narrow(designs.SALSANET_DILATED),
    "salsanext-v1": lambda: narrow(designs.V1_POOLING),
    "rangenet53": lambda: RangeNet53(1, width=2),
}


def positive(module):
    """Give a network weights with which nothing can cancel."""
    for values in module.parameters():
        torch.nn.init.constant_(values, 1 / values[0].numel())
    return module.double().eval()


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("axis", [0, 1])
def test_it_is_where_the_gradient_is_not_zero(name, axis, monkeypatch):
    monkeypatch.setattr("salsanext_cli.network.salsanext.CONTEXT_WIDTH", 4)
    module = positive(NETWORKS[name]())
    # Two lines at the coarsest level: the taps of a 2×2 window, dilated, lie both outside of one.
    size = [max(4, 2 * step) for step in module.stride]
    size[axis] = 1024 if name == "rangenet53" else 576
    image = torch.ones(1, 5, *size, dtype=torch.float64, requires_grad=True)
    logits = module(image)[0, 0]
    dependence = module.rest(*module.trunk(Dependence.of(*size)))
    assert dependence.shape == tuple(size)
    for place in (3, 288, 293):
        pixel = [2, 2]
        pixel[axis] = place
        (gradient,) = torch.autograd.grad(logits[tuple(pixel)], image, retain_graph=True)
        found = gradient[0].sum(dim=(0, 2 - axis)).nonzero().flatten()
        spans = (dependence.rows, dependence.columns)[axis][:, place].abs()
        assert [int(found[0]), int(found[-1])] == spans.tolist()


def test_windows_add_up():
    """Of 3×3 convolutions in a row: 1 + 2 each, times what lies between their pixels."""
    image = Dependence.of(64, 64)
    weight = torch.ones(1, 1, 3, 3)
    once = F.conv2d(image, weight, None, (1, 1), (1, 1), (1, 1), 1)
    assert once.rows[:, 30].abs().tolist() == [29, 31]
    wide = F.conv2d(once, weight, None, (1, 2), (2, 2), (2, 2), 1)
    assert wide.rows[:, 30].abs().tolist() == [27, 33]
    assert wide.columns[:, 15].abs().tolist() == [27, 33]
    assert wide.rows[:, 0].abs().tolist() == [0, 3]


def test_of_the_whole_network():
    assert receptive_field(SalsaNext(1)) == (425, 425)
    height, width = receptive_field(RangeNet53(1, width=2))
    # Thirty-five 3×3 convolutions, none of a stride in height.
    assert height == 1 + 2 * 35
    assert width > 10 * height


def test_a_function_without_a_rule():
    with pytest.raises(NotImplementedError, match="relu"):
        F.relu(Dependence.of(4, 4))
