# SPDX-License-Identifier: MIT
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salsanext_cli.measures.sums import Sums

SCANS = st.lists(st.lists(st.floats(0, 1e6, width=32), max_size=5), max_size=6)


def of(values: list[float]) -> Sums:
    return Sums.none(1).update(np.array(values, np.float64), np.zeros(len(values), int))


@settings(max_examples=40, deadline=None)
@given(SCANS, st.randoms(use_true_random=False))
def test_scans_add_up_to_the_same_in_any_order(scans, random):
    one = sum((of(scan) for scan in scans), start=Sums.none(1))
    random.shuffle(scans)
    other = Sums.none(1)
    for scan in scans:
        other = of(scan) + other
    assert one == other


def test_nothing_is_lost_where_floats_would_round():
    small = sum((of([2.0**-40]) for _ in range(1000)), start=of([2.0**30]))
    exact = Fraction(2) ** 30 + 1000 * Fraction(2) ** -40
    assert 2.0**30 + 2.0**-40 == 2.0**30
    assert Fraction(small.units[0], 2**100) == exact


def test_means_of_groups():
    sums = Sums.none(3).update(np.array([1.0, 2.0, 6.0]), np.array([0, 2, 2], np.uint8))
    np.testing.assert_array_equal(sums.means(np.array([1, 0, 2])), [1, np.nan, 4])
    assert sums.total().means(np.array([3])) == 3
    assert sums.group(2).means(np.array([2])) == 4
    assert math.isnan(Sums.none(1).means(np.array([0]))[0])


def test_sums_of_different_groups_do_not_add():
    with pytest.raises(ValueError, match="zip"):
        Sums.none(2) + Sums.none(3)
