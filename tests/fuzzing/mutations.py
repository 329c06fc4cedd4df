# SPDX-License-Identifier: MIT
"""Files that are almost right: what damage, carelessness or malice makes of valid ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

from hypothesis import strategies as st

HUGE = (
    *(b"0", b"-1", b"1", b"255", b"256", b"65536", b"2147483647", b"2147483648", b"4294967295"),
    *(b"1000000000000", b"9223372036854775807", b"18446744073709551616", b"-9223372036854775809"),
    *(b"1e400", b"1e-400", b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"0x" + b"f" * 64),
    *(b"9" * 5000, b"1_000", b"1.5", b"''", b"null", b"true", b"[]", b"{}"),
)
"""What is written in the place of a number."""
WORDS = (
    *(b"\0", b"\n", b"\r\n", b"\xff\xfe", b"\xed\xa0\x80", b"..", b"../../x", b"/etc/passwd"),
    *(b"[" * 40, b"{" * 40, b'{"a":' * 40, b"- " * 40, b"(", b")", b":", b"=", b",", b"'", b'"'),
    *(b"&a [*a]", b"*a", b"<<: *a", b"!!python/object/apply:os.system [id]", b"!!int ''"),
    *(b"!!timestamp x", b"2001-99-99", b"!!binary =", b"!!bool x", b"0b1", b"1:2:3", b"#", b"---"),
    *(b"list uchar int", b"property", b"element vertex 1000000000000", b"COUNT 0", b"binary"),
    *(b"POINTSX 20000000\n", b"DATAX binary\n", b"SIZES 4\n", b"WIDTH_ 9\n"),
    *(b"_ F 4 0", b"'<f8'", b"'|O'", b"ctorch\n_utils\n", b"cos\nsystem\n", b"\x80\x02", b"PK\x03"),
)
"""What is written anywhere: the words of the formats, and of those who attack them."""
EDGES = (0, 1, 2, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 10**12, 2**62)
EDGES += (2**63 - 1, 2**63, 2**64 - 1)
"""Lengths and offsets at the border of what fields hold."""
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?")

Edit = Callable[[bytes], bytes]


def _at(share: int, length: int) -> int:
    return share * length >> 16


def _flip(share: int, mask: int) -> Edit:
    def edit(data: bytes) -> bytes:
        if not data:
            return data
        place = _at(share, len(data))
        return data[:place] + bytes([data[place] ^ mask]) + data[place + 1 :]

    return edit


def _put(share: int, new: bytes, *, over: bool) -> Edit:
    def edit(data: bytes) -> bytes:
        place = _at(share, len(data) + 1)
        return data[:place] + new + data[place + over * len(new) :]

    return edit


def _cut(share: int, length: int) -> Edit:
    def edit(data: bytes) -> bytes:
        place = _at(share, len(data) + 1)
        return data[:place] + data[place + length :]

    return edit


def _repeat(share: int, length: int, times: int) -> Edit:
    def edit(data: bytes) -> bytes:
        place = _at(share, len(data) + 1)
        return data[:place] + data[place : place + length] * times + data[place:]

    return edit


def _repeat_line(share: int, times: int) -> Edit:
    def edit(data: bytes) -> bytes:
        lines = data.splitlines(keepends=True) or [b""]
        place = _at(share, len(lines))
        return b"".join([*lines[:place], lines[place] * times, *lines[place:]])

    return edit


def _swap_lines(one: int, other: int) -> Edit:
    def edit(data: bytes) -> bytes:
        lines = data.splitlines(keepends=True) or [b""]
        a, b = _at(one, len(lines)), _at(other, len(lines))
        lines[a], lines[b] = lines[b], lines[a]
        return b"".join(lines)

    return edit


def _renumber(share: int, number: bytes) -> Edit:
    def edit(data: bytes) -> bytes:
        # The header is where numbers promise something.
        found = list(NUMBER.finditer(data[:4096]))
        if not found:
            return data
        match = found[_at(share, len(found))]
        return data[: match.start()] + number + data[match.end() :]

    return edit


def _splice(share: int, other: bytes) -> Edit:
    def edit(data: bytes) -> bytes:
        return data[: _at(share, len(data) + 1)] + other[_at(share, len(other) + 1) :]

    return edit


def edits(seeds: Sequence[bytes]) -> st.SearchStrategy[Edit]:
    """Return what changes bytes a little, near others of the same kind."""
    share, short = st.integers(0, 0xFFFF), st.integers(1, 64)
    edges = st.builds(
        lambda value, size: (value % 256**size).to_bytes(size, "little"),
        st.sampled_from(EDGES),
        st.sampled_from((1, 2, 4, 8)),
    )
    words = st.sampled_from(WORDS) | edges | st.binary(max_size=8)
    return st.one_of(
        st.builds(_flip, share, st.integers(1, 255)),
        st.builds(_put, share, words, over=st.booleans()),
        st.builds(_cut, share, short | st.just(1 << 30)),
        st.builds(_repeat, share, short, st.sampled_from((1, 3, 100))),
        st.builds(_repeat_line, share, st.sampled_from((1, 3, 100))),
        st.builds(_swap_lines, share, share),
        st.builds(_renumber, share, st.sampled_from(HUGE)),
        st.builds(_splice, share, st.sampled_from(seeds)),
    )


def damage(random: Random, seeds: Sequence[bytes]) -> bytes:
    """Return what `damaged` may return, drawn a hundred times faster and never made simpler."""
    if random.random() < 0.1:
        return random.randbytes(random.randrange(300))
    data = random.choice(seeds)
    for _ in range(random.randint(1, 4)):
        share, length = random.randrange(1 << 16), random.randint(1, 64)
        edge = random.choice(EDGES) % 256 ** (size := random.choice((1, 2, 4, 8)))
        word = random.choice((random.choice(WORDS), edge.to_bytes(size, "little")))
        edit = random.choice(
            (
                _flip(share, random.randint(1, 255)),
                _put(share, word, over=random.random() < 0.5),
                _cut(share, random.choice((length, 1 << 30))),
                _repeat(share, length, random.choice((1, 3, 100))),
                _repeat_line(share, random.choice((1, 3, 100))),
                _swap_lines(share, random.randrange(1 << 16)),
                _renumber(share, random.choice(HUGE)),
                _splice(share, random.choice(seeds)),
            )
        )
        data = edit(data)
    return data


def damaged(seeds: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """Return valid files with a few edits, and now and then any bytes at all."""

    def apply(data: bytes, chain: list[Edit]) -> bytes:
        for edit in chain:
            data = edit(data)
        return data

    near = st.builds(apply, st.sampled_from(seeds), st.lists(edits(seeds), min_size=1, max_size=4))
    return st.one_of(near, near, near, near, near, near, near, st.binary(max_size=300))
