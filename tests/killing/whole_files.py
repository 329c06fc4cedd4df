# SPDX-License-Identifier: MIT
"""Checks that files are complete, and that folders are equal."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from safetensors.torch import load_file

from salsanext_cli.io.files.atomic import TEMPORARY
from salsanext_cli.io.formats.ply import ply_columns
from salsanext_cli.runs.scans.scan_folders import FILE_LISTS

WHOLE: dict[str, Callable[[Path], Any]] = {
    ".bin": lambda path: path.exists(),
    ".label": lambda path: path.stat().st_size and path.stat().st_size % 4 == 0,
    ".ply": ply_columns,
    ".npy": lambda path: np.load(path).size,
    ".json": lambda path: json.loads(path.read_text()),
    ".yaml": lambda path: yaml.safe_load(path.read_text()),
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".txt": lambda path: path.read_text().endswith("\n"),
    ".html": lambda path: path.read_text("utf-8").endswith("</html>\n"),
    ".png": lambda path: path.read_bytes().endswith(b"IEND\xaeB`\x82"),
    ".csv": lambda path: len({line.count(",") for line in path.read_text().splitlines()}) == 1,
    ".safetensors": load_file,
    # Its first and its last eight bytes are the same.
    ".mcap": lambda path: path.read_bytes()[:8] == path.read_bytes()[-8:],
}
"""Functions by suffix that fail, or return a false value, for a partial file."""


def files(folder: Path, *, hidden: bool = False) -> dict[str, Path]:
    """Return the visible or the hidden files below a folder by name, without its file lists."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        str(path.relative_to(folder)): path
        for path in paths
        if _is_hidden(path.relative_to(folder)) == hidden and FILE_LISTS not in path.parts
    }


def _is_hidden(path: Path) -> bool:
    """Return whether a relative path, or a folder of it, is hidden."""
    return any(name.startswith(".") for name in path.parts)


def require_whole(folder: Path) -> None:
    """Fail if a visible file is partial, or the files of a scan differ in length."""
    for path in files(folder).values():
        assert WHOLE[path.suffix](path) or path.name.endswith(".warnings.json"), path
    for labels in folder.glob("sequences/*/predictions/*.label"):
        values = labels.parents[1] / "probabilities" / f"{labels.stem}.npy"
        if values.exists():
            assert len(np.load(values)) * 4 == labels.stat().st_size


def require_tidy(folder: Path, *, killed: bool = False) -> None:
    """Fail if a hidden file is left, except temporary files of a killed process."""
    left = [path.name for path in files(folder, hidden=True).values()]
    assert not [name for name in left if not (killed and TEMPORARY.fullmatch(name))]


def require_alike(expected: Path, actual: Path) -> None:
    """Fail if two folders differ in their visible files, except records of warnings.

    A killed run loses its warnings, which are written at the end.
    """
    mine, theirs = (
        {name: path for name, path in files(folder).items() if not name.endswith(".warnings.json")}
        for folder in (expected, actual)
    )
    assert mine.keys() == theirs.keys(), sorted(mine.keys() ^ theirs.keys())
    for name, path in mine.items():
        assert path.read_bytes() == theirs[name].read_bytes(), name
