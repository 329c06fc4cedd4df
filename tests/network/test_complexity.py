# SPDX-License-Identifier: MIT
import pytest
import torch

from salsanext_cli.network.complexity import (
    PAPERS,
    agrees,
    multiply_accumulates,
    parameter_count,
)
from salsanext_cli.network.registry import ARCHITECTURES, build

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


@pytest.fixture(scope="module")
def costs():
    """Return parameters and multiply-accumulates of every network."""
    found = {}
    for name in ARCHITECTURES:
        with torch.device("meta"):
            module = build({"name": name})
        found[name] = parameter_count(module), multiply_accumulates(module)
    return found


def test_costs_are_those_of_arithmetic(costs):
    assert costs == COUNTS
    assert list(costs) == list(PAPERS)


def test_an_image_that_must_be_padded_costs_what_the_padded_one_does():
    module = build({"name": "salsanet"})
    assert multiply_accumulates(module, 20, 100) == multiply_accumulates(module, 32, 112)
    assert parameter_count(module) == COUNTS["salsanet"][0]


@pytest.mark.parametrize("name", sorted(set(PAPERS) - OFF))
def test_parameters_are_those_of_the_papers_to_the_digit(costs, name):
    assert agrees(costs[name][0], PAPERS[name].parameters)


@pytest.mark.parametrize("name", sorted(OFF))
def test_parameters_that_the_papers_print_otherwise(costs, name):
    count, printed = costs[name][0], PAPERS[name].parameters
    assert not agrees(count, printed)
    assert count / 1e6 == pytest.approx(float(printed), abs=0.02)


@pytest.mark.parametrize(
    "name", [n for n, paper in PAPERS.items() if paper.flops and paper.determined]
)
def test_convolutions_are_a_little_less_than_all_operations(costs, name):
    share = 2 * costs[name][1] / 1e9 / float(PAPERS[name].flops)
    assert 0.989 < share < 0.999


def test_one_row_is_not_determined(costs):
    assert [name for name, paper in PAPERS.items() if not paper.determined] == ["salsanet-dilated"]
    share = 2 * costs["salsanet-dilated"][1] / 1e9 / float(PAPERS["salsanet-dilated"].flops)
    assert 0.9 < share < 0.91


@pytest.mark.parametrize(
    ("count", "printed", "holds"),
    [
        (6_649_428, "6.64", True),
        (6_649_428, "6.65", True),
        (6_649_428, "6.63", False),
        (50_377_364, "51", False),
    ],
)
def test_agreement_is_rounded_or_cut_off(count, printed, holds):
    assert agrees(count, printed) is holds
