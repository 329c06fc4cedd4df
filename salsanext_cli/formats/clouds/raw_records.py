# SPDX-License-Identifier: MIT
"""Content of files without header that cannot be float32 records of points."""

import re

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

MAGIC = {
    b"ply": ".ply",
    b"# .PCD": ".pcd",
    b"VERSION ": ".pcd",
    b"LASF": ".las",
    b"\x93NUMPY": ".npy",
    b"PK\x03\x04": ".npz",
    b"\x1f\x8b": ".gz",
}
"""Suffixes of other formats by the bytes that their files begin with."""
TEXT_SUFFIX = ".csv"
TEXT_BYTES = 4096
"""Size of the start of a file that shows whether it is text."""
MIN_TEXT_BYTES = 16
"""Size of a file that is called text."""
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
"""Bytes that do not occur in text; blanks, line ends and escapes do."""
LEAST, MOST = 1e-12, 1e7
"""Possible magnitudes of values other than 0, in metres and in any unit of intensity and time."""
LEAST_POSSIBLE_SHARE = 0.5
"""Share of coordinates that are possible in any scan; of random bytes it is a quarter."""
LEAST_POSSIBLE_SHARE_OF_LOW = 0.42
"""The same of every second float32, of which a scanner of one plane has half, z, equal to 0."""
LEAST_POSSIBLE_SHARE_OF_FLOAT64 = 0.9
SAMPLE = 4096
"""Rows that are looked at, evenly spaced."""


def other_suffix(content: bytes) -> str | None:
    """Return the suffix for content that begins as another format or as text does, else None."""
    for magic, suffix in MAGIC.items():
        if content.startswith(magic):
            return suffix
    start = content[:TEXT_BYTES]
    if CONTROL.search(start):
        return None
    try:
        start.decode()
    except UnicodeDecodeError as error:
        # A character may be cut at the end.
        if error.start < len(start) - 3 or len(content) <= TEXT_BYTES:
            return None
    return TEXT_SUFFIX


def are_float64(values: Float) -> bool:
    """Say whether float32 values are the halves of float64 ones.

    `values` (M,) float32, all values of a file.

    Returns true if most are possible as float64 and most of their low halves are not as float32:
    those of rounded decimals are random, those that were float32 before have one of eight values,
    of which six are impossible.
    """
    if len(values) % 2:
        return False
    halves = np.ascontiguousarray(_sample(values.reshape(-1, 2)))
    halves = halves[halves.view("<u4").any(axis=1)]
    if not len(halves):
        return False
    possible = are_possible(halves.view("<f8")).mean()
    possible_low = are_possible(halves[:, 0]).mean()
    return bool(
        possible > LEAST_POSSIBLE_SHARE_OF_FLOAT64 and possible_low < LEAST_POSSIBLE_SHARE_OF_LOW
    )


def are_coordinates(values: Float) -> bool:
    """Say whether coordinates (N, 3) float32 can be metres, for all that are a measurement."""
    rows = _sample(values)
    measured = rows[np.isfinite(rows) & (rows != 0)]
    return int(are_possible(measured).sum()) >= LEAST_POSSIBLE_SHARE * len(measured)


def _sample(rows: Float) -> Float:
    # An odd step meets all columns.
    return rows[:: len(rows) // SAMPLE | 1]


def are_possible(values: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Mark the magnitudes that a measurement may have; 0 and NaN are none."""
    # A NaN may signal.
    with np.errstate(invalid="ignore"):
        magnitudes = np.abs(values)
        possible: npt.NDArray[np.bool_] = (magnitudes > LEAST) & (magnitudes < MOST)
    return possible
