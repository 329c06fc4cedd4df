# SPDX-License-Identifier: MIT
"""Networks, their costs, and the metadata of weights files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.network.complexity import (
    PAPERS,
    RECEPTIVE_FIELDS,
    PaperFigures,
    agrees,
    multiply_accumulates,
    parameter_count,
)
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.weights import WeightsCard, read_card
from salsanext_cli.storage.identity import fingerprint

HEIGHT, WIDTH = 64, 2048


@dataclass(frozen=True, slots=True)
class Model:
    """A network, what it costs on one range image of 64×2048, and what the papers print of it.

    Attributes
    ----------
    name : str
        As weights files and recipes name it.
    parameters : int
        Trainable numbers, with 20 classes.
    multiply_accumulates : int
        Of the convolutions; the papers print twice as many FLOPs, and those of the rest.
    receptive_field : (int, int)
        Height and width of what a pixel's logits depend on; more than the image is beyond it.
    paper : PaperFigures
        The papers' figures.
    agrees : bool
        Whether the parameters are those that the paper prints, to the digit.
    """

    name: str
    parameters: int
    multiply_accumulates: int
    receptive_field: tuple[int, int]
    paper: PaperFigures
    agrees: bool


def models() -> list[Model]:
    """Build every network, without its numbers, and count."""
    return [_model(name) for name in ARCHITECTURES]


def _model(name: str) -> Model:
    with torch.device("meta"):
        module = build({"name": name}).eval()
    parameters, paper = parameter_count(module), PAPERS[name]
    return Model(
        name=name,
        parameters=parameters,
        multiply_accumulates=multiply_accumulates(module, HEIGHT, WIDTH),
        receptive_field=RECEPTIVE_FIELDS[name],
        paper=paper,
        agrees=agrees(parameters, paper.parameters),
    )


def describe_weights(path: Path) -> Mapping[str, Any]:
    """Return the metadata of a weights file, its size and its digest as plain data."""
    card: WeightsCard = read_card(path)
    return {
        "path": str(path),
        "sha256": fingerprint(path),
        "bytes": path.stat().st_size,
        "description": card.description,
        "architecture": dict(card.architecture),
        "temperature": card.temperature,
        "label_space": card.space.name,
        "classes": list(card.space.names),
        "sensor": card.sensor.to_dict(),
        "recipe": dict(card.recipe),
        "scores": dict(card.scores),
    }
