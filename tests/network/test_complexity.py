# SPDX-License-Identifier: MIT
from dataclasses import replace

import pytest
import torch
from architectures import EACH

from salsanext_cli.network.complexity import (
    agrees,
    multiply_accumulates,
    paper_figures,
    parameter_count,
)
from salsanext_cli.network.rangenet53 import RangeNet53
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.salsanext import SalsaNext

SAME = {"rangenet53", "salsanet-shuffle", "salsanext-v1-pooling"}
"""Another way to build a network, and rungs that only the loss tells from others."""
OFF = {"salsanext", "salsanet-shuffle", "salsanet-pooling"}
"""What the papers print differs from what their text and their code give."""

COUNTS = {
    "salsanext": (6_711_572, 62_297_997_312),
    "salsanext-v1": (23_262_548, 33_042_726_912),
    "rangenet53": (50_377_364, 359_707_705_344),
    "salsanet": (6_582_612, 25_593_643_008),
    "salsanet-context": (6_649_428, 34_263_269_376),
    "salsanet-dropout": (6_649_428, 34_263_269_376),
    "salsanet-pooling": (5_865_588, 33_055_309_824),
    "salsanet-dilated": (9_246_036, 73_052_192_768),
    "salsanet-shuffle": (6_711_572, 62_297_997_312),
    "salsanext-v1-layers": (26_386_516, 32_002_539_520),
    "salsanext-v1-context": (26_406_196, 34_552_676_352),
    "salsanext-v1-dropout": (26_406_196, 34_552_676_352),
    "salsanext-v1-pooling": (23_262_548, 33_042_726_912),
}
"""Parameters and multiply-accumulates of 64×2048, by arithmetic from the papers' text."""


@pytest.mark.parametrize("name", EACH)
def test_costs_are_those_of_arithmetic(name):
    with torch.device("meta"):
        module = build({"name": name})
    assert (parameter_count(module), multiply_accumulates(module)) == COUNTS[name]


def test_every_architecture_has_figures():
    assert list(ARCHITECTURES) == list(COUNTS) == list(paper_figures())


@pytest.mark.parametrize("name", paper_figures())
def test_parameters_are_those_of_the_papers_to_the_digit(name):
    count, printed = COUNTS[name][0], paper_figures()[name].parameters
    assert agrees(count, printed) == (name not in OFF)
    assert name not in OFF or count / 1e6 == pytest.approx(float(printed), abs=0.02)


# Receptive fields, against gradients


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


@pytest.mark.parametrize("name", [each for each in EACH if each.values[0] not in SAME])
def test_receptive_fields_are_where_gradients_are_not_zero(name, monkeypatch):
    monkeypatch.setattr("salsanext_cli.network.salsanext.CONTEXT_WIDTH", 4)
    side = extent(narrow(ARCHITECTURES[name].keywords["design"]), axis=0)
    assert paper_figures()[name].receptive_field == [side, side]


@pytest.mark.parametrize("axis", [0, 1])
def test_the_receptive_field_of_rangenet53(axis):
    assert (
        extent(RangeNet53(1, width=2), axis) == paper_figures()["rangenet53"].receptive_field[axis]
    )
