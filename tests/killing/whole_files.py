# SPDX-License-Identifier: MIT
"""Files of a folder: complete, and the same as those of another."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from salsanext_cli.files.atomic import TEMPORARY
from salsanext_cli.results.owned_folder import FILE_LISTS


def _is_png(path: Path) -> None:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    assert content.endswith(b"IEND\xaeB`\x82")


def _is_csv(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert len({line.count(",") for line in lines}) == 1, lines
    assert path.read_text().endswith("\n")


def _is_ply(path: Path) -> None:
    from salsanext_cli.formats.ply import ply_columns

    ply_columns(path)


def _is_weights(path: Path) -> None:
    from safetensors.torch import load_file

    from salsanext_cli.network.weights import read_weights

    load_file(path)
    if path.name != "checkpoint.safetensors":
        read_weights(path)


def _is_labels(path: Path) -> None:
    length = path.stat().st_size
    assert length, path
    assert length % 4 == 0, path


WHOLE: dict[str, Callable[[Path], Any]] = {
    ".bin": lambda path: None,
    ".label": _is_labels,
    ".ply": _is_ply,
    ".npy": lambda path: np.load(path),
    ".json": lambda path: json.loads(path.read_text()),
    ".yaml": lambda path: yaml.safe_load(path.read_text()),
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".txt": lambda path: path.read_text().endswith("\n"),
    ".png": _is_png,
    ".csv": _is_csv,
    ".safetensors": _is_weights,
}
"""Functions that raise, by suffix, if a file is not whole."""


def files(folder: Path, *, hidden: bool = False) -> dict[str, Path]:
    """Return the hidden files below a folder or the others, by name, but no records of writing."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        str(path.relative_to(folder)): path
        for path in found
        if path.name.startswith(".") == hidden and FILE_LISTS not in path.parts
    }


def require_whole(folder: Path) -> None:
    """Fail if a file that can be seen is half written; those of one scan must be of one length."""
    for path in files(folder).values():
        WHOLE[path.suffix](path)
    for labels in folder.glob("sequences/*/predictions/*.label"):
        values = labels.parents[1] / "probabilities" / f"{labels.stem}.npy"
        if values.exists():
            assert len(np.load(values)) * 4 == labels.stat().st_size


def require_tidy(folder: Path, *, killed: bool = False) -> None:
    """Fail if a hidden file is left, but for unfinished ones of a killed process.

    These are removed when they are a day old.
    """
    left = [path.name for path in files(folder, hidden=True).values()]
    if killed:
        left = [name for name in left if not TEMPORARY.fullmatch(name)]
    assert not left, left


def require_alike(expected: Path, found: Path) -> None:
    """Fail if two folders do not show the same files with the same content.

    What a killed run found doubtful of scans is lost: it is written at the end.
    """
    mine, theirs = (
        {name: path for name, path in files(folder).items() if not name.endswith(".warnings.json")}
        for folder in (expected, found)
    )
    assert mine.keys() == theirs.keys(), sorted(mine.keys() ^ theirs.keys())
    for name, path in mine.items():
        assert path.read_bytes() == theirs[name].read_bytes(), name
