# SPDX-License-Identifier: MIT
"""Networks, their costs, and the metadata of weights files."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.classes.label_space import plugged_label_spaces
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.formats import plugged_formats
from salsanext_cli.network.card import WeightsCard, read_card
from salsanext_cli.network.complexity import (
    agrees,
    multiply_accumulates,
    paper_figures,
    parameter_count,
)
from salsanext_cli.network.registry import ARCHITECTURES, build, plugged_networks

HEIGHT, WIDTH = 64, 2048


def models() -> list[dict[str, Any]]:
    """Return, as plain data, what every network costs on 64×2048 pixels, and what papers print."""
    costs = []
    for name in ARCHITECTURES:
        with torch.device("meta"):
            module = build({"name": name}).eval()
        parameters, paper = parameter_count(module), asdict(paper_figures()[name])
        costs.append(
            {
                "name": name,
                "parameters": parameters,
                "multiply_accumulates": multiply_accumulates(module, HEIGHT, WIDTH),
                "receptive_field": paper.pop("receptive_field"),
                "paper": paper,
                "agrees": agrees(parameters, paper["parameters"]),
            }
        )
    return costs


def plug_ins() -> list[dict[str, str]]:
    """Return kind, name and distribution of all plug-ins as plain data."""
    kinds = {
        "format": plugged_formats(),
        "network": plugged_networks(),
        "label space": plugged_label_spaces(),
    }
    return [
        {"kind": kind, "name": each.name, "distribution": each.distribution}
        for kind, by_name in kinds.items()
        for each in by_name.values()
    ]


def describe_weights(path: Path) -> Mapping[str, Any]:
    """Return the metadata of a weights file, its size and its digest as plain data."""
    card: WeightsCard = read_card(path)
    return {
        "path": str(path),
        **({"version": card.version} if card.version else {}),
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
        "error": dict(card.error.scores) if card.error else None,
        "risk": dict(card.risk) or None,
        "accuracy": dict(card.accuracy) or None,
        "trained_on": len(card.trained_on),
    }
