# SPDX-License-Identifier: MIT
"""Kind of a file by its first bytes, where a file of points without a header is expected."""

import re

from salsanext_cli.io.formats import FORMATS

MAGIC = {
    **{magic: form.suffixes[0] for form in FORMATS.values() for magic in form.magic},
    b"\x1f\x8b": "a gzip file",
    b"#ROSBAG": ".bag",
    b"\x89MCAP0": ".mcap",
    b"ASTM-E57": "an E57 file",
    b"LASF": "a LAS file",
    b"\x00\x01\x00\x00": "a message of ROS 2",  # in CDR, little endian
}
"""Suffixes or names of other formats by their first bytes."""
TEXT_SUFFIX = ".csv"
TERRASCAN = b"\xa1\xce\x0e\x00CXYZ"  # Bytes 8 to 16 of files of TerraScan
TEXT_BYTES = 4096  # Size of the start of a file that shows whether it is text
MIN_TEXT_BYTES = 256  # Size from which float32 values contain bytes that do not occur in text
MIN_ASCII_BYTES = 16  # The same for ASCII, which is hardly ever coordinates in metres
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")  # Bytes that do not occur in text


def other_kind(start: bytes) -> str | None:
    """Return suffix or name of another format, or of text, by the first bytes; None without one."""
    for magic, kind in MAGIC.items():
        if start.startswith(magic):
            return kind
    least = MIN_ASCII_BYTES if start.isascii() else MIN_TEXT_BYTES
    if len(start) >= least and not CONTROL.search(start):
        return TEXT_SUFFIX
    return "a TerraScan file" if start[8:16] == TERRASCAN else None
