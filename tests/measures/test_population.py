# SPDX-License-Identifier: MIT
"""Scans unlike those of a guarantee are recognised, and scans like them are not."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.measures.population import LIKELY, label_traits, of_units, population_difference
from salsanext_cli.network.card import LabelTraits

NAMES = ("car", "road", "building")


def units(rng, count, uncertainty, shares, concentration=60.0):
    """Draw units around a mean uncertainty and mean shares of the classes."""
    drawn = rng.dirichlet(concentration * np.array(shares), count)
    spread = rng.normal(uncertainty, 0.02, count).clip(0.01, 0.99)
    return [
        LabelTraits(unit=str(i), uncertainty=float(c), class_shares=tuple(map(float, row)))
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
    drawn = [LabelTraits(unit=str(c), uncertainty=c, class_shares=(1.0,)) for c in values]
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
    difference = population_difference(usual, others, NAMES)
    one = 1 / math.comb(before + now, now)
    assert difference is None or difference.chance >= one
    assert one <= LIKELY or difference is None


def test_too_few_scans_show_no_difference():
    rng = np.random.default_rng(3)
    before = units(rng, 20, 0.9, (0.2, 0.5, 0.3))
    assert population_difference(before, units(rng, 1, 0.3, (0.9, 0.05, 0.05)), NAMES) is None
    assert population_difference((), before, NAMES) is None
    assert population_difference(before, (), NAMES) is None


@given(st.lists(st.integers(0, 1000), min_size=4, max_size=4), st.floats(0, 1))
def test_shares_are_those_of_the_labelled_points(points, uncertainty):
    values = np.array([uncertainty, np.nan, uncertainty], np.float32)
    traits = label_traits("00/000000", np.array(points), values)
    total = sum(points[1:])
    expected = [count / total if total else 0 for count in points[1:]]
    assert traits.class_shares == pytest.approx(expected, abs=1e-4)
    assert traits.uncertainty == pytest.approx(uncertainty, abs=1e-4)


def test_drives_have_the_mean_of_their_scans():
    scans = [
        LabelTraits(unit=str(i), uncertainty=c, class_shares=(c, 1 - c))
        for i, c in enumerate((0.2, 0.4, 0.9))
    ]
    drives = of_units(scans, ["b", "b", "a"])
    assert [drive.unit for drive in drives] == ["a", "b"]
    assert [drive.uncertainty for drive in drives] == pytest.approx([0.9, 0.3])
    assert drives[1].class_shares == pytest.approx((0.3, 0.7))
