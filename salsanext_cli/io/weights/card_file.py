# SPDX-License-Identifier: MIT
"""Cards in weights files, and the weights of the package."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import safetensors

from salsanext_cli.core.errors import FormatError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.weights_names import (
    DEFAULT_NAME,
    PAPER_NETWORKS,
    paper_networks_hint,
)
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import nearest, shortened
from salsanext_cli.io.files.atomic import WEIGHTS_SUFFIX
from salsanext_cli.io.files.reading import fingerprint, is_folder, present, reading, refusing_damage

ONNX_SUFFIX = ".onnx"
DEFAULT_FILE = "presets/weights/default.safetensors"  # In the package


def read_card(path: Path) -> WeightsCard:
    """Read only the metadata of a weights file."""
    if path.suffix == ONNX_SUFFIX:
        problem = "is an ONNX model"
        hint = "use the weights from which it was exported"
        raise WeightsError(path, problem, "a .safetensors file", hint)
    try:
        with (
            reading(path),
            refusing_damage(path, "a .safetensors file"),
            safetensors.safe_open(path, framework="np") as file,
        ):
            metadata = file.metadata() or {}
    except FormatError as error:
        problem = error.problem
        hint = "copy it again"
        if not present(path):
            problem = "no such file"
            hint = hint_for_missing(path)
        elif is_folder(path):
            problem = "is a folder"
            hint = "name the file in it"
        elif path.suffix != WEIGHTS_SUFFIX:
            hint = "convert a published checkpoint with `salsanext import-weights`"
        raise WeightsError(path, problem, "a .safetensors file", hint) from error
    return WeightsCard.from_metadata(metadata, path)


def default_weights() -> Path:
    """Return the path of the weights of the package."""
    return Path(str(resources.files("salsanext_cli") / DEFAULT_FILE))


def hint_for_missing(path: Path) -> str:
    """Return what helps if there is no weights file of a path."""
    from salsanext_cli.io.files.atomic import WEIGHTS_SUFFIX  # Only errors need numpy

    if str(path).startswith(PAPER_NETWORKS):
        return paper_networks_hint()
    beside = {file.name: str(file) for file in path.parent.glob(f"*{WEIGHTS_SUFFIX}")}
    if path.name == str(path):
        beside[DEFAULT_NAME] = DEFAULT_NAME
    likely = nearest(path.name, beside)
    return f"did you mean {beside[likely]}?" if likely else "check the name"


def named_weights(card: WeightsCard, path: Path) -> str:
    """Return the version of weights or the name of their file, and its SHA-256."""
    name = f"default weights version {card.version}" if card.version else path.name
    return f"{name} (SHA-256 {fingerprint(path)[:16]})"


def weights_title(card: WeightsCard, path: Path) -> str:
    """Name default weights with their description up to the first colon or full stop."""
    start = re.split(r"[:.](?:\s|$)", card.description, maxsplit=1)[0]
    summary = shortened(start[:1].lower() + start[1:])
    if card.version:
        return f"{named_weights(card, path)}, {summary},"
    return f"default weights ({summary})"


@dataclass(frozen=True, slots=True, kw_only=True)
class DescribedWeights:
    """Card of a weights file, and its size and digest."""

    path: Path
    sha256: str
    size: int  # Bytes
    card: WeightsCard

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        card = self.card
        names = ("description", "architecture", "temperature", "recipe", "scores", "risk")
        return {
            "path": str(self.path),
            **({"version": card.version} if card.version else {}),
            "sha256": self.sha256,
            "bytes": self.size,
            "tensors_sha256": card.tensors_sha256 or None,
            **{name: plain(getattr(card, name)) for name in (*names, "accuracy", "sensor")},
            "label_space": card.space.name,
            "classes": list(card.space.names),
            "error": card.error and dict(card.error.scores),
            "int8": len(card.int8),
            "trained_on": len(card.trained_on),
            "widths": list(card.trained_widths),
        }
