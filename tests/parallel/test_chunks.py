# SPDX-License-Identifier: MIT
from itertools import pairwise
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.parallel.chunks import LARGEST, PER_WORKER, chunks
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
def test_every_scan_is_in_one_chunk_and_in_order(lengths, workers):
    scans = scans_of(lengths)
    assert [scan for chunk in chunks(scans, workers) for scan in chunk] == scans


@given(LENGTHS, WORKERS)
def test_a_chunk_is_of_one_sequence_and_neither_empty_nor_large(lengths, workers):
    for chunk in chunks(scans_of(lengths), workers):
        assert len({scan.sequence for scan in chunk}) == 1
        assert 1 <= len(chunk) <= LARGEST


@given(LENGTHS, WORKERS)
def test_every_worker_has_several_if_there_are_enough(lengths, workers):
    scans = scans_of(lengths)
    assert len(chunks(scans, workers)) >= min(len(scans), PER_WORKER * workers)


@given(LENGTHS, WORKERS)
def test_chunks_of_a_sequence_are_alike(lengths, workers):
    for one, other in pairwise(chunks(scans_of(lengths), workers)):
        if one[0].sequence == other[0].sequence:
            assert abs(len(one) - len(other)) <= 1


def test_many_scans_make_large_chunks():
    assert {len(chunk) for chunk in chunks(scans_of([1600]), 4)} == {LARGEST}
