# SPDX-License-Identifier: MIT
"""Digests of scans, by which weights know those that they were trained on.

A digest is of the coordinates of the points: copies of a scan have the same one, whatever their
name, folder, format or intensity.
"""

import hashlib
import re
from collections.abc import Iterable

import numpy as np

from salsanext_cli.records import Scan

DIGITS = 16
"""Hexadecimal digits of a digest: by chance, two of 20 000 scans agree once in 10¹¹ cases."""


def scan_digest(scan: Scan) -> str:
    """Return the digest of a scan."""
    return hashlib.sha256(np.ascontiguousarray(scan.points).data).hexdigest()[:DIGITS]


def joined(digests: Iterable[str]) -> str:
    """Return digests as one text: those of SemanticKITTI's training take 306 kB."""
    return "".join(digests)


def parted(text: object) -> list[str]:
    """Return the digests of a text as `joined` returns it; anything else raises `ValueError`."""
    if not isinstance(text, str) or not re.fullmatch(f"([0-9a-f]{{{DIGITS}}})*", text):
        raise ValueError("no digests of scans")
    return [text[i : i + DIGITS] for i in range(0, len(text), DIGITS)]
