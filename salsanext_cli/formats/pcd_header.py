# SPDX-License-Identifier: MIT
"""Header of a PCD file: fields and their types, number of points, encoding."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, BinaryIO

import numpy as np

KINDS = ("ascii", "binary", "binary_compressed")
TYPES = {
    **{f"F{size}": f"<f{size}" for size in (4, 8)},
    **{f"I{size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"U{size}": f"<u{size}" for size in (1, 2, 4, 8)},
}
"""numpy's type of each TYPE and SIZE."""
CODES = {kind: code for code, kind in TYPES.items()}
PADDING = "_"
MAX_HEADER_BYTES = 1 << 16
"""Size of the largest header and of the largest row."""


@dataclass(frozen=True, slots=True)
class Header:
    """Fields, points and encoding of a PCD file.

    Attributes
    ----------
    names, types, counts : tuples of equal length
        Fields in order of storage: name, numpy type, values per point.
    points : int
        N.
    kind : str
        One of `KINDS`.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    kind: str

    def __post_init__(self) -> None:
        if not len(self.names) == len(self.types) == len(self.counts):
            raise ValueError("a PCD header whose FIELDS, TYPE, SIZE and COUNT differ in length")
        named = [name for name in self.names if name != PADDING]
        if len(set(named)) < len(named):
            raise ValueError("a PCD header with a field twice")
        if self.points < 0 or min(self.counts, default=0) < 0:
            raise ValueError("a PCD header with a negative number")
        if self.row_size > MAX_HEADER_BYTES:
            raise ValueError(f"a PCD header with {self.row_size} bytes per point")
        if self.kind not in KINDS:
            raise ValueError(f"PCD data of kind {self.kind}, not {', '.join(KINDS)}")

    @property
    def scalars(self) -> list[int]:
        """Indices of the fields with one named value per point."""
        return [
            i
            for i, (name, count) in enumerate(zip(self.names, self.counts, strict=True))
            if name != PADDING and count == 1
        ]

    @property
    def row_size(self) -> int:
        """Size of one point in bytes, padding included."""
        return sum(self._sizes())

    @property
    def row(self) -> np.dtype[Any]:
        """Type of a point in plain binary data, with gaps for padding."""
        *offsets, row_size = accumulate(self._sizes(), initial=0)
        return np.dtype(
            {
                "names": [self.names[i] for i in self.scalars],
                "formats": [self.types[i] for i in self.scalars],
                "offsets": [offsets[i] for i in self.scalars],
                "itemsize": row_size,
            }
        )

    def encode(self) -> bytes:
        """Return the header in its usual form and order, of a cloud in one row."""
        types = [CODES[kind] for kind in self.types]
        return (
            f"VERSION 0.7\nFIELDS {' '.join(self.names)}\nSIZE {' '.join(t[1:] for t in types)}\n"
            f"TYPE {' '.join(t[0] for t in types)}\nCOUNT {' '.join(map(str, self.counts))}\n"
            f"WIDTH {self.points}\nHEIGHT 1\nPOINTS {self.points}\nDATA {self.kind}\n"
        ).encode()

    def _sizes(self) -> list[int]:
        return [
            np.dtype(kind).itemsize * count
            for kind, count in zip(self.types, self.counts, strict=True)
        ]


def read_header(file: BinaryIO) -> Header:
    """Read up to the line DATA; an unusable header raises `ValueError`."""
    entries = _entries(file)
    try:
        names = tuple(entries["FIELDS"])
        kinds, sizes = entries["TYPE"], entries["SIZE"]
        counts = entries.get("COUNT", ["1"] * len(names))
        points = entries.get("POINTS") or entries["WIDTH"] + entries["HEIGHT"]
        return Header(
            names,
            tuple(TYPES[kind + size] for kind, size in zip(kinds, sizes, strict=False)),
            tuple(_number(count) for count in counts),
            math.prod(map(_number, points)),
            entries["DATA"][0].lower(),
        )
    except (KeyError, IndexError) as error:
        raise ValueError(f"a PCD header without a usable {error}") from error


def _entries(file: BinaryIO) -> dict[str, list[str]]:
    """Return the words after each keyword."""
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = file.readline(MAX_HEADER_BYTES)
        if not line or file.tell() > MAX_HEADER_BYTES:
            raise ValueError("no PCD header")
        words = line.decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    return entries


def _number(word: str) -> int:
    """Return a number of fields or points, of a size that can be calculated with."""
    if len(word) > 15:
        raise ValueError("a PCD header with an impossible number")
    try:
        return int(word)
    except ValueError as error:
        raise ValueError(f"a PCD header with {word} in place of a number") from error
