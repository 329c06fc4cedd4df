# SPDX-License-Identifier: MIT
"""Costs of the networks, plug-ins, and metadata of weights files."""

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
    """Compute the costs of every network, for images of 64×2048 pixels.

    Returns
    -------
    list of NetworkCosts
        Parameters and operations.
    """
    costs = []
    for name in ARCHITECTURES:
        with torch.device("meta"):
            module = build({"name": name}).eval()
        operations = multiply_accumulates(module, HEIGHT, WIDTH)
        costs.append(NetworkCosts(name, parameter_count(module), operations))
    return costs


def plug_ins() -> list[dict[str, str]]:
    """List the installed plug-ins.

    Returns
    -------
    list of dict
        Kind, name and distribution of each plug-in.
    """
    kinds = {
        "format": plugged_formats(),
        "network": plugged_networks(),
        "label space": plugged_label_spaces(),
    }
    return [
        {"kind": kind, "name": plug_in.name, "distribution": plug_in.distribution}
        for kind, by_name in kinds.items()
        for plug_in in by_name.values()
    ]


def describe_weights(path: Path) -> DescribedWeights:
    """Read the metadata of a weights file.

    Parameters
    ----------
    path : Path
        Weights file (.safetensors).

    Returns
    -------
    DescribedWeights
        Metadata, size and SHA-256.
    """
    card = read_card(path)
    return DescribedWeights(path, fingerprint(path), path.stat().st_size, card)
