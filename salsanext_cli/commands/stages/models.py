# SPDX-License-Identifier: MIT
"""Plug-ins, and metadata of weights files."""

from pathlib import Path

from salsanext_cli.core.network.registry import plugged_networks
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.formats import plugged_formats
from salsanext_cli.io.label_spaces import plugged_label_spaces
from salsanext_cli.io.weights.card_file import DescribedWeights, read_card
from salsanext_cli.io.weights.tensor_digest import require_intact


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
    """Read the metadata of a weights file, and check its tensors.

    Parameters
    ----------
    path : Path
        Weights file (.safetensors).

    Returns
    -------
    DescribedWeights
        Metadata, size and SHA-256.

    Raises
    ------
    WeightsError
        If the file cannot be read, or its tensors have changed.
    """
    card = read_card(path)
    require_intact(path, card.tensors_sha256)
    return DescribedWeights(
        path=path, sha256=fingerprint(path), size=path.stat().st_size, card=card
    )
