# SPDX-License-Identifier: MIT
"""Costs of the networks and receptive fields, and the figures that the papers print."""

import copy
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal
from functools import cache
from importlib import resources

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS


@dataclass(frozen=True, slots=True)
class PaperFigures:
    """Receptive field of a network, and what a paper prints, every digit; None if not known."""

    # Height and width of the window of the image that a pixel's logits depend on
    receptive_field: Sequence[int]
    row: str  # Table and row
    parameters: str  # In millions
    # Of one image of 64×2048, in 10⁹, every multiplication and every addition
    flops: str | None = None
    # In the table of ablations, SemanticKITTI, without and with the vote of the nearest neighbours,
    # in %
    miou_pixels: str | None = None
    miou: str | None = None
    miou_test: str | None = None  # On the benchmark's test sequences, in %
    determined: bool = True  # The text says all that the network is made of


@dataclass(frozen=True, slots=True)
class NetworkCosts:
    """Costs of a network on range images, and the figures of its paper."""

    name: str
    parameters: int
    multiply_accumulates: int
    receptive_field: Sequence[int]  # Height and width in pixels
    paper: PaperFigures
    agrees: bool  # Whether the number of parameters is the paper's


@cache
def paper_figures() -> dict[str, PaperFigures]:
    """Return the figures of every network, by the name of the architecture."""
    text = resources.files("salsanext_cli").joinpath("presets/networks.toml").read_text("utf-8")
    return {name: PaperFigures(**figures) for name, figures in tomllib.loads(text).items()}


def parameter_count(module: nn.Module) -> int:
    """Return the number of trainable numbers in a network."""
    return sum(parameter.numel() for parameter in module.parameters())


def multiply_accumulates(module: SegmentationNetwork, height: int = 64, width: int = 2048) -> int:
    """Count the multiply-accumulates of one range image, convolutions only; nothing is computed."""
    copied = copy.deepcopy(module).to("meta").eval()
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        copied(torch.empty(1, len(CHANNELS), height, width, device="meta"))
    operations: int = counter.get_total_flops()
    return operations // 2


def agrees(count: int, printed: str) -> bool:
    """Return whether a count is the printed number of millions, rounded or cut off."""
    digit, millions = Decimal(printed), Decimal(count) / 1_000_000
    return digit in (millions.quantize(digit, way) for way in (ROUND_HALF_UP, ROUND_DOWN))
