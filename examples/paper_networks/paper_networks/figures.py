# SPDX-License-Identifier: MIT
"""Figures of the networks: counted, and as the papers print them."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal
from functools import cache
from pathlib import Path

import torch
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS


@dataclass(frozen=True, slots=True)
class PaperFigures:
    """Figures of a network with every printed digit; None if unknown.

    Attributes
    ----------
    receptive_field : sequence of int
        Height and width, in pixels, of the window of the image that a pixel's logits depend on.
    row : str
        Table and row of the paper.
    parameters : str
        Number of parameters in millions.
    flops : str, optional
        Multiplications and additions of one image of 64×2048, in 10⁹.
    miou_pixels, miou : str, optional
        Mean IoU in the table of ablations, SemanticKITTI, without and with kNN, in %.
    miou_test : str, optional
        Mean IoU on the test sequences of the benchmark, in %.
    determined : bool
        Whether the text describes the network completely.
    """

    receptive_field: Sequence[int]
    row: str
    parameters: str
    flops: str | None = None
    miou_pixels: str | None = None
    miou: str | None = None
    miou_test: str | None = None
    determined: bool = True


@cache
def paper_figures() -> dict[str, PaperFigures]:
    """Return the figures of every network by its name."""
    text = Path(__file__).with_name("figures.toml").read_text("utf-8")
    return {name: PaperFigures(**figures) for name, figures in tomllib.loads(text).items()}


def agrees(count: int, printed: str) -> bool:
    """Return whether a count is the printed number of millions, rounded or cut off."""
    digit, millions = Decimal(printed), Decimal(count) / 1_000_000
    return digit in (millions.quantize(digit, way) for way in (ROUND_HALF_UP, ROUND_DOWN))


def costs(module: SegmentationNetwork, height: int = 64, width: int = 2048) -> tuple[int, int]:
    """Count parameters, and multiply-accumulates of the convolutions of one image.

    The module is on the device "meta", so that nothing is computed.
    """
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        module.eval()(torch.empty(1, len(CHANNELS), height, width, device="meta"))
    return sum(p.numel() for p in module.parameters()), counter.get_total_flops() // 2
