# SPDX-License-Identifier: MIT
"""Whether every file that can be seen in a folder is complete."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

POINTS_OF = {"predictions": (4, np.uint32)}


def _is_png(path: Path) -> None:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    assert content.endswith(b"IEND\xaeB`\x82")


def _is_csv(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert len({line.count(",") for line in lines}) == 1, lines
    assert path.read_text().endswith("\n")


def _is_safetensors(path: Path) -> None:
    from safetensors.torch import load_file

    from salsanext_cli.network.weights import read_weights

    load_file(path)
    if path.name != "checkpoint.safetensors":
        read_weights(path)


WHOLE: dict[str, Callable[[Path], Any]] = {
    ".label": lambda path: _divisible(path, 4),
    ".npy": lambda path: np.load(path),
    ".json": lambda path: json.loads(path.read_text()),
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".png": _is_png,
    ".csv": _is_csv,
    ".safetensors": _is_safetensors,
}
"""What raises, by suffix, if a file is not whole."""


def _divisible(path: Path, size: int) -> None:
    length = path.stat().st_size
    assert length, path
    assert length % size == 0, path


def seen(folder: Path) -> dict[str, Path]:
    """Return the files below a folder by name that are not hidden, nor in hidden folders."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    named = {path.relative_to(folder): path for path in files}
    return {str(n): p for n, p in named.items() if not any(x.startswith(".") for x in n.parts)}


def require_whole(folder: Path) -> None:
    """Fail if a file that can be seen is half written; those of one scan must be of one length."""
    for path in seen(folder).values():
        WHOLE[path.suffix](path)
    for labels in folder.glob("sequences/*/predictions/*.label"):
        values = labels.parents[1] / "probabilities" / f"{labels.stem}.npy"
        if values.exists():
            assert len(np.load(values)) * 4 == labels.stat().st_size


def all_alike(expected: Path, found: Path) -> None:
    """Fail if two folders do not show the same files with the same content."""
    mine, theirs = seen(expected), seen(found)
    assert mine.keys() == theirs.keys(), sorted(mine.keys() ^ theirs.keys())
    for name, path in mine.items():
        assert path.read_bytes() == theirs[name].read_bytes(), name
