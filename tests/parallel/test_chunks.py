# SPDX-License-Identifier: MIT
from itertools import pairwise
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.parallel.chunks import MAX_CHUNK_SCANS, MIN_CHUNKS_PER_WORKER, chunks
from salsanext_cli.storage.layout import ScanFile

LENGTHS = st.lists(st.integers(0, 120), max_size=6)
WORKERS = st.integers(1, 40)


def scans_of(lengths):
    return [
        ScanFile(f"{sequence:02d}", f"{n:06d}", Path(f"/{sequence}/{n}.bin"))
        for sequence, length in enumerate(lengths)
        for n in range(length)
    ]


@given(LENGTHS, WORKERS)
def test_chunks_hold_every_scan_in_order_and_are_alike_within_a_sequence(lengths, workers):
    scans = scans_of(lengths)
    found = chunks(scans, workers)
    assert [scan for chunk in found for scan in chunk] == scans
    assert len(found) >= min(len(scans), MIN_CHUNKS_PER_WORKER * workers)
    for chunk in found:
        assert len({scan.sequence for scan in chunk}) == 1
        assert 1 <= len(chunk) <= MAX_CHUNK_SCANS
    for one, other in pairwise(found):
        assert one[0].sequence != other[0].sequence or abs(len(one) - len(other)) <= 1


def test_many_scans_make_large_chunks():
    assert {len(chunk) for chunk in chunks(scans_of([1600]), 4)} == {MAX_CHUNK_SCANS}
