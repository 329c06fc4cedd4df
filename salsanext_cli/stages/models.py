# SPDX-License-Identifier: MIT
"""Networks, their costs, and the metadata of weights files."""

from pathlib import Path

import torch

from salsanext_cli.classes.label_space import plugged_label_spaces
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.formats import plugged_formats
from salsanext_cli.network.card import DescribedWeights, read_card
from salsanext_cli.network.complexity import NetworkCosts, multiply_accumulates, parameter_count
from salsanext_cli.network.registry import ARCHITECTURES, build, plugged_networks

HEIGHT, WIDTH = 64, 2048


def models() -> list[NetworkCosts]:
    """Return the costs of every network."""
    costs = []
    for name in ARCHITECTURES:
        with torch.device("meta"):
            module = build({"name": name}).eval()
        operations = multiply_accumulates(module, HEIGHT, WIDTH)
        costs.append(NetworkCosts(name, parameter_count(module), operations))
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


def describe_weights(path: Path) -> DescribedWeights:
    """Return the card of a weights file, its size and its digest."""
    card = read_card(path)
    return DescribedWeights(path, fingerprint(path), path.stat().st_size, card)
