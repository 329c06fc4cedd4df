# SPDX-License-Identifier: MIT
"""Batches hold every item once and in order, and become smaller for good where memory ends."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.engines.batches import BatchSize


@given(st.integers(0, 40), st.integers(1, 9), st.integers(1, 9))
def test_every_item_is_computed_once_in_order_as_far_as_memory_allows(count, most, fitting):
    def computed(batch):
        if len(batch) > fitting:
            raise MemoryError
        return list(batch)

    size = BatchSize(most, "scans")
    batches = list(size.in_batches(computed, range(count)))
    assert [item for batch in batches for item in batch] == list(range(count))
    assert all(len(batch) <= min(most, fitting) for batch in batches)
    if count:
        assert 1 <= size.most <= most


def test_a_smaller_size_stays_and_is_a_warning(caplog):
    size = BatchSize(8, "passes")

    def computed(batch):
        if len(batch) > 3:
            raise MemoryError
        return len(batch)

    assert list(size.in_batches(computed, range(6))) == [3, 3]
    assert size.most == 3
    assert list(size.in_batches(computed, range(4))) == [3, 1]
    assert len(caplog.records) == 1


def test_one_item_that_does_not_fit_is_an_error():
    def computed(batch):
        raise MemoryError

    with pytest.raises(MemoryError, match="one of the scans"):
        list(BatchSize(4, "scans").in_batches(computed, range(4)))


def test_another_error_passes():
    def computed(batch):
        raise RuntimeError("shapes do not fit")

    with pytest.raises(RuntimeError, match="shapes"):
        list(BatchSize(4, "scans").in_batches(computed, range(4)))
