# SPDX-License-Identifier: MIT
"""Mutations of valid files: damaged, edited by hand, or hostile."""

from __future__ import annotations

import re
from collections.abc import Sequence
from random import Random

HUGE = (
    *(b"0", b"-1", b"1", b"255", b"256", b"65536", b"2147483647", b"2147483648", b"4294967295"),
    *(b"1000000000000", b"9223372036854775807", b"18446744073709551616", b"-9223372036854775809"),
    *(b"1e400", b"1e-400", b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"0x" + b"f" * 64),
    *(b"9" * 5000, b"1_000", b"1.5", b"''", b"null", b"true", b"[]", b"{}"),
)
"""Replacements of a number."""
WORDS = (
    *(b"\0", b"\n", b"\r\n", b"\xff\xfe", b"\xed\xa0\x80", b"..", b"../../x", b"/etc/passwd"),
    *(b"[" * 40, b"{" * 40, b'{"a":' * 40, b"- " * 40, b"(", b")", b":", b"=", b",", b"'", b'"'),
    *(b"&a [*a]", b"*a", b"<<: *a", b"!!python/object/apply:os.system [id]", b"!!int ''"),
    *(b"!!timestamp x", b"2001-99-99", b"!!binary =", b"!!bool x", b"0b1", b"1:2:3", b"#", b"---"),
    *(b"list uchar int", b"property", b"element vertex 1000000000000", b"COUNT 0", b"binary"),
    *(b"POINTSX 20000000\n", b"DATAX binary\n", b"SIZES 4\n", b"WIDTH_ 9\n", b"\\d", b"\\400"),
    *(b"_ F 4 0", b"'<f8'", b"'|O'", b"ctorch\n_utils\n", b"cos\nsystem\n", b"\x80\x02", b"PK\x03"),
)
"""Insertions at any place: keywords of the formats and of attacks on their readers."""
EDGES = (0, 1, 2, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 10**12, 2**62)
EDGES += (2**63 - 1, 2**63, 2**64 - 1)
"""Lengths and offsets at the limits of integer types."""
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?")
HEADER_BYTES = 4096
"""Size of the start of a file in which numbers are replaced."""
MAX_FILE_BYTES = 1 << 22
"""Size at which a damaged file is cut: repeated lines of binary files would be hundreds of MB."""


def _flip(data: bytes, at: int, random: Random) -> bytes:
    flipped = bytes(byte ^ random.randint(1, 255) for byte in data[at : at + 1])
    return data[:at] + flipped + data[at + 1 :]


def _put(data: bytes, at: int, random: Random) -> bytes:
    size = random.choice((1, 2, 4, 8))
    edge = (random.choice(EDGES) % 256**size).to_bytes(size, "little")
    new = random.choice((random.choice(WORDS), edge))
    return data[:at] + new + data[at + random.choice((0, len(new))) :]


def _cut(data: bytes, at: int, random: Random) -> bytes:
    return data[:at] + data[at + random.choice((random.randint(1, 64), len(data))) :]


def _repeat(data: bytes, at: int, random: Random) -> bytes:
    piece = data[at : at + random.randint(1, 64)]
    return data[:at] + piece * random.choice((1, 3, 100)) + data[at:]


def _repeat_line(data: bytes, _at: int, random: Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    line = random.randrange(len(lines))
    return b"".join([*lines[:line], lines[line] * random.choice((1, 3, 100)), *lines[line:]])


def _swap_lines(data: bytes, _at: int, random: Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    a, b = random.randrange(len(lines)), random.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def _renumber(data: bytes, _at: int, random: Random) -> bytes:
    found = list(NUMBER.finditer(data[:HEADER_BYTES]))
    if not found:
        return data
    match = random.choice(found)
    return data[: match.start()] + random.choice(HUGE) + data[match.end() :]


EDITS = (_flip, _put, _cut, _repeat, _repeat_line, _swap_lines, _renumber)


def damage(random: Random, seeds: Sequence[bytes]) -> bytes:
    """Return a valid file with a few edits, the rest of another one, or any bytes at all."""
    if random.random() < 0.1:
        return random.randbytes(random.randrange(300))
    data = random.choice(seeds)
    for _ in range(random.randint(1, 4)):
        at = random.randint(0, len(data))
        if random.random() < 1 / 8:
            other = random.choice(seeds)
            data = data[:at] + other[random.randint(0, len(other)) :]
        else:
            data = random.choice(EDITS)(data, at, random)[:MAX_FILE_BYTES]
    return data
