# SPDX-License-Identifier: MIT
"""Costs of the networks and receptive fields, and the figures that the papers print."""

import copy
from dataclasses import dataclass
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS

RECEPTIVE_FIELDS = {
    "salsanext": (425, 425),
    "salsanext-v1": (543, 543),
    "rangenet53": (71, 853),
    "salsanet": (267, 267),
    "salsanet-context": (285, 285),
    "salsanet-dropout": (285, 285),
    "salsanet-pooling": (285, 285),
    "salsanet-dilated": (425, 425),
    "salsanet-shuffle": (425, 425),
    "salsanext-v1-layers": (539, 539),
    "salsanext-v1-context": (543, 543),
    "salsanext-v1-dropout": (543, 543),
    "salsanext-v1-pooling": (543, 543),
}
"""Height and width of the window of the image that a pixel's logits depend on, by architecture; the
largest, where it differs between the pixels of a cell of the coarsest level."""
V2 = "arXiv 2003.03653v3, Table II"
V1 = "arXiv 2003.03653v1, Table II"


@dataclass(frozen=True, slots=True)
class PaperFigures:
    """Figures of a paper, as text, so that every digit is its own; None if not known for sure."""

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


PAPERS = {
    "salsanext": PaperFigures(
        f"{V2}: + Lovász-Softmax", "6.73", "125.68", "56.6", "59.5", miou_test="59.5"
    ),
    "salsanext-v1": PaperFigures(f"{V1}: + Lovász-Softmax", "23.26"),
    "rangenet53": PaperFigures(
        "arXiv 2003.03653v3, Tables I and III: RangeNet53++", "50", "720.96", miou_test="52.2"
    ),
    "salsanet": PaperFigures(f"{V2}: SalsaNet", "6.58", "51.60", "43.5", "44.8", miou_test="45.4"),
    "salsanet-context": PaperFigures(f"{V2}: + context module", "6.64", "69.20", "44.7", "46.0"),
    "salsanet-dropout": PaperFigures(f"{V2}: + central dropout", "6.64", "69.20", "44.6", "46.3"),
    "salsanet-pooling": PaperFigures(f"{V2}: + average pooling", "5.85", "66.78", "47.7", "49.9"),
    "salsanet-dilated": PaperFigures(
        f"{V2}: + dilated convolution", "9.25", "161.60", "48.2", "50.4", determined=False
    ),
    "salsanet-shuffle": PaperFigures(f"{V2}: + pixel-shuffle", "6.73", "125.68", "50.4", "53.0"),
    "salsanext-v1-layers": PaperFigures(f"{V1}: + extra layers", "26.38"),
    "salsanext-v1-context": PaperFigures(f"{V1}: + context module", "26.40"),
    "salsanext-v1-dropout": PaperFigures(f"{V1}: + new dropout", "26.40"),
    "salsanext-v1-pooling": PaperFigures(f"{V1}: + average pooling", "23.26"),
}
"""Rows by the name of the architecture. The test figures are of Table I; SalsaNet's there is not
that of its row in the table of ablations."""


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
