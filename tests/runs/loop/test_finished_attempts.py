# SPDX-License-Identifier: MIT
"""Attempts that a worker wrote are read back, and what is cut off is not."""

import pytest
from worker_tasks import scans_of

from salsanext_cli.runs.loop.finished_attempts import FinishedAttempts, append_attempt
from salsanext_cli.runs.loop.job import Attempt


@pytest.mark.parametrize("cut", range(40))
def test_an_attempt_that_is_cut_off_is_not_read(tmp_path, cut):
    """Of two attempts of one chunk, the second is not complete, or both are."""
    finished, scans = FinishedAttempts(tmp_path), scans_of("a", "b")
    for scan in scans:
        append_attempt(finished.file(3), Attempt(file=scan, result=scan.stem))
    path = finished.file(3)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - cut])
    expected = ["a"] if cut else ["a", "b"]
    assert [attempt.get() for attempt in finished] == expected
    finished.forget(3)
    assert not [*finished]


def test_an_attempt_after_one_that_is_cut_off_is_no_attempt(tmp_path):
    """The file of a chunk contains an attempt, half of the second, and the third."""
    finished, scans = FinishedAttempts(tmp_path), scans_of("a", "b", "c")
    path, ends = finished.file(0), [0]
    for scan in scans:
        append_attempt(path, Attempt(file=scan, result=scan.stem))
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    for cut in range(ends[1] + 1, ends[2]):
        path.write_bytes(content[:cut] + content[ends[2] :])
        assert [attempt.get() for attempt in finished] == ["a"]
    path.write_bytes(content[: ends[1]] + bytes(100))
    assert [attempt.get() for attempt in finished] == ["a"]


def test_what_a_full_disk_cuts_off_is_removed_before_the_next_attempt(tmp_path):
    resource = pytest.importorskip("resource")
    finished, scans = FinishedAttempts(tmp_path), scans_of("a", "b", "c")
    path = finished.file(0)
    append_attempt(path, Attempt(file=scans[0], result="a"))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 10, before[1]))
    try:
        append_attempt(path, Attempt(file=scans[1], result="b"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    append_attempt(path, Attempt(file=scans[2], result="c"))
    assert [attempt.get() for attempt in finished] == ["a", "c"]
