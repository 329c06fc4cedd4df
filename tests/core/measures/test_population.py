# SPDX-License-Identifier: MIT
"""Scans unlike those of a guarantee are recognised, and scans like them are not."""

import itertools
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.geometry.scan_measures import MEASURES
from salsanext_cli.core.measures.population import (
    LIKELY,
    are_comparable,
    new_codes,
    population_difference,
    traits_of_units,
    unit_traits,
    upper_tail,
)
from salsanext_cli.core.network.unit_traits import UnitTraits

NAMES = ("car", "road", "building")


def units(rng, count, uncertainty, shares, concentration=60.0):
    """Draw units around a mean uncertainty and mean shares of the classes."""
    drawn = rng.dirichlet(concentration * np.array(shares), count)
    spread = rng.normal(uncertainty, 0.02, count).clip(0.01, 0.99)
    return [
        UnitTraits(unit=str(i), uncertainty=float(c), class_shares=tuple(map(float, row)))
        for i, (c, row) in enumerate(zip(spread, drawn, strict=True))
    ]


def test_units_of_one_source_differ_as_rarely_as_stated():
    rng = np.random.default_rng(1)
    differs = 0
    for _ in range(100):
        drawn = units(rng, 20, 0.8, (0.2, 0.5, 0.3))
        differs += population_difference(drawn[:12], drawn[12:], NAMES) is not None
    # Six or more of 100 happen with a chance of one in 2 000 if each has a chance of 1 %.
    assert differs < 6


@pytest.mark.parametrize(
    ("uncertainty", "shares", "trait"),
    [(0.6, (0.2, 0.5, 0.3), "uncertainty"), (0.8, (0.2, 0.1, 0.7), "building")],
)
def test_the_trait_that_differs_most_is_named(uncertainty, shares, trait):
    rng = np.random.default_rng(2)
    before = units(rng, 20, 0.8, (0.2, 0.5, 0.3))
    now = units(rng, 10, uncertainty, shares)
    difference = population_difference(before, now, NAMES)
    assert difference.chance <= LIKELY
    if trait == "building":
        assert difference.trait in ("road", "building")
    else:
        assert difference.trait == trait
        assert difference.now == pytest.approx(np.mean([unit.uncertainty for unit in now]))
        assert difference.before == pytest.approx(np.mean([unit.uncertainty for unit in before]))


def test_the_chance_is_that_of_all_divisions():
    # All 10 divisions of five units into three and two; only one is as extreme as that observed.
    values = [0.5, 0.51, 0.52, 0.9, 0.91]
    drawn = [UnitTraits(unit=str(c), uncertainty=c, class_shares=(1.0,)) for c in values]
    assert population_difference(drawn[:3], drawn[3:], ("road",)) is None
    logits = np.log(np.array(values) / (1 - np.array(values)))
    gaps = [
        abs(logits[[*two]].mean() - np.delete(logits, [*two]).mean())
        for two in itertools.combinations(range(5), 2)
    ]
    assert sum(gap >= gaps[-1] - 1e-12 for gap in gaps) == 1


@pytest.mark.parametrize(("before", "now"), [(65, 1), (85, 1), (98, 1), (1, 97), (12, 2), (5, 3)])
def test_no_chance_is_below_that_of_one_division(before, now):
    # The permutations that are drawn may lack the observed division, even if it is likely.
    rng = np.random.default_rng(4)
    usual = units(rng, before, 0.9, (0.2, 0.5, 0.3))
    others = units(rng, now, 0.3, (0.9, 0.05, 0.05))
    one = 1 / math.comb(before + now, now)
    assert are_comparable(before, now) == (one <= LIKELY)
    difference = population_difference(usual, others, NAMES)
    if are_comparable(before, now):
        assert difference is None or difference.chance >= one


@pytest.mark.parametrize(("before", "now"), [(600, 600), (4071, 170), (5000, 5000)])
def test_groups_with_more_divisions_than_a_float_can_hold_are_compared(before, now):
    assert math.comb(before + now, now) > sys.float_info.max
    assert are_comparable(before, now)


def test_many_scans_differ_by_the_same_measure_as_few():
    rng = np.random.default_rng(7)
    drawn = units(rng, 1200, 0.8, (0.2, 0.5, 0.3))
    others = units(rng, 600, 0.7, (0.2, 0.5, 0.3))
    assert population_difference(drawn[:600], drawn[600:], NAMES) is None
    assert population_difference(drawn[:600], others, NAMES).trait == "uncertainty"


@pytest.mark.parametrize("count", [8, 24])
def test_a_single_unit_differs_only_beyond_a_prediction_interval(count):
    rng = np.random.default_rng(3)
    differs = 0
    for _ in range(200):
        drawn = units(rng, count + 1, 0.8, (0.2, 0.5, 0.3))
        differs += population_difference(drawn[:count], drawn[count:], NAMES) is not None
    # Shares are not normally distributed; two of 200 would be likely with a chance of 1 %.
    assert differs == 0
    usual = units(rng, count, 0.8, (0.2, 0.5, 0.3))
    others = units(rng, 1, 0.8, (0.01, 0.01, 0.98), 500.0)
    assert not are_comparable(count, 1)
    assert population_difference(usual, others, NAMES).trait in ("road", "building")


def test_no_units_show_no_difference():
    drawn = units(np.random.default_rng(3), 20, 0.9, (0.2, 0.5, 0.3))
    assert population_difference((), drawn, NAMES) is None
    assert population_difference(drawn, (), NAMES) is None
    assert population_difference(drawn[:1], drawn[1:2], NAMES) is None


@pytest.mark.parametrize(("value", "degrees"), [(0, 3), (2, 1), (6.9, 23), (4, 8)])
def test_the_tail_is_that_of_the_distribution_of_student(value, degrees):
    special = pytest.importorskip("scipy.special")
    assert upper_tail(value, degrees) == pytest.approx(special.stdtr(degrees, -value), rel=1e-5)


def with_measures(drawn, rng, **changed):
    """Add measures that vary by 1 % around usual ones, some of which are changed."""
    usual = np.array([changed.get(measure.name, 2.0) for measure in MEASURES])
    scatter = rng.normal(1, 0.01, (len(drawn), len(MEASURES)))
    rows = zip(drawn, usual * scatter, strict=True)
    return [replace(unit, measures=tuple(map(float, row))) for unit, row in rows]


@pytest.mark.parametrize("count", [1, 4])
def test_another_sensor_is_told_apart_where_classes_are_alike(count):
    rng = np.random.default_rng(5)
    drawn = units(rng, 24 + count, 0.8, (0.2, 0.5, 0.3))
    before, now = with_measures(drawn[:24], rng), drawn[24:]
    other = with_measures(now, rng, **{"highest elevation": 12.0})
    difference = population_difference(before, other, NAMES)
    assert difference.trait == "highest elevation"
    assert str(difference).startswith("highest elevation 1")
    assert population_difference(before, with_measures(now, rng), NAMES) is None
    # A threshold of an early version has no measures, so that only labels are compared.
    assert population_difference(drawn[:24], other, NAMES) is None


def test_a_code_that_most_new_units_have_tells_them_apart():
    drawn = units(np.random.default_rng(6), 6, 0.8, (0.2, 0.5, 0.3))
    before = [replace(unit, codes=("sparse",)) for unit in drawn[:1]] + drawn[1:3]
    seen = [replace(unit, codes=("part-of-circle", "sparse")) for unit in drawn[3:5]]
    assert new_codes(before, [*seen, drawn[5]]) == ("part-of-circle",)
    assert new_codes(before, [seen[0], drawn[5]]) == ()
    (drive,) = traits_of_units([*seen, drawn[5]], ["a"] * 3)
    assert drive.codes == ("part-of-circle", "sparse")


@given(st.lists(st.integers(0, 1000), min_size=4, max_size=4), st.floats(0, 1))
def test_shares_are_those_of_the_labelled_points(points, uncertainty):
    values = np.array([uncertainty, np.nan, uncertainty], np.float32)
    traits = unit_traits("00/000000", np.array(points), values)
    total = sum(points[1:])
    expected = [count / total if total else 0 for count in points[1:]]
    assert traits.class_shares == pytest.approx(expected, abs=1e-4)
    assert traits.uncertainty == pytest.approx(uncertainty, abs=1e-4)


def test_drives_have_the_mean_of_their_scans():
    scans = [
        UnitTraits(unit=str(i), uncertainty=c, class_shares=(c, 1 - c))
        for i, c in enumerate((0.2, 0.4, 0.9))
    ]
    drives = traits_of_units(scans, ["b", "b", "a"])
    assert [drive.unit for drive in drives] == ["a", "b"]
    assert [drive.uncertainty for drive in drives] == pytest.approx([0.9, 0.3])
    assert drives[1].class_shares == pytest.approx((0.3, 0.7))
