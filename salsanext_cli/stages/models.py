# SPDX-License-Identifier: MIT
"""Which networks there are, what they cost, and what weights files say of themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.network.architectures import ARCHITECTURES, build
from salsanext_cli.network.cost import multiply_accumulates, parameter_count
from salsanext_cli.network.weights import WeightsCard, fingerprint, read_card

HEIGHT, WIDTH = 64, 2048


@dataclass(frozen=True, slots=True)
class Model:
    """A network and what it costs on one range image of 64×2048.

    Attributes
    ----------
    name : str
        As weights files name it.
    parameters : int
        Trainable numbers, with 20 classes.
    multiply_accumulates : int
        Of the convolutions; the papers print twice as many FLOPs.
    """

    name: str
    parameters: int
    multiply_accumulates: int


def models() -> list[Model]:
    """Build every network and count."""
    found = []
    for name in ARCHITECTURES:
        module = build({"name": name})
        parameters = parameter_count(module)
        found.append(Model(name, parameters, multiply_accumulates(module, HEIGHT, WIDTH)))
    return found


def describe_weights(path: Path) -> Mapping[str, Any]:
    """Return what a weights file says of itself, as plain data."""
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
