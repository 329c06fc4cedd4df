# SPDX-License-Identifier: MIT
"""Digests of scans, by which weights know those that they were trained on.

A digest is the number of points and a hash of their coordinates: copies of a scan have the same
one, whatever their name, folder, format or intensity.
"""

import hashlib
import re
from collections.abc import Callable, Collection, Iterable

import numpy as np

from salsanext_cli.records import Scan

COUNT_DIGITS, HASH_DIGITS = 8, 16
"""Hexadecimal digits of a digest: by chance, two of 20 000 scans agree once in 10¹¹ cases."""
DIGITS = COUNT_DIGITS + HASH_DIGITS


def scan_digest(scan: Scan) -> str:
    """Return the digest of a scan."""
    of_points = hashlib.sha256(np.ascontiguousarray(scan.points).data).hexdigest()
    return f"{len(scan):0{COUNT_DIGITS}x}{of_points[:HASH_DIGITS]}"


def is_among(digests: Collection[str], count: int, read: Callable[[], Scan]) -> bool:
    """Return whether digests name a scan of so many points; it is read only where it may be one."""
    start = f"{count:0{COUNT_DIGITS}x}"
    return any(digest.startswith(start) for digest in digests) and scan_digest(read()) in digests


def joined(digests: Iterable[str]) -> str:
    """Return digests as one text: those of SemanticKITTI's training take 459 kB."""
    return "".join(digests)


def parted(text: object) -> list[str]:
    """Return the digests of a text as `joined` returns it; anything else raises `ValueError`."""
    if not isinstance(text, str) or not re.fullmatch(f"([0-9a-f]{{{DIGITS}}})*", text):
        raise ValueError("no digests of scans")
    return [text[i : i + DIGITS] for i in range(0, len(text), DIGITS)]
