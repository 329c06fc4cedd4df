# SPDX-License-Identifier: MIT
"""Scans of a run are compared with those of a threshold as far as its record and they allow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL

from salsanext_cli.core.geometry.scan_measures import MEASURES
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.sensors.sensor import FittedView
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary import threshold_scans
from salsanext_cli.runs.summary.threshold_scans import (
    EARLY,
    ThresholdComparison,
    TraitSample,
    why_incomparable,
)

CLASSES = ("car", "road")


def traits(unit, seed, factor=1.0, codes=()):
    """Return traits of a scan around usual ones; a factor changes its measures."""
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet((20, 40))
    measures = factor * rng.normal(2, 0.02, len(MEASURES))
    return UnitTraits(
        unit=unit,
        uncertainty=float(rng.normal(0.2, 0.01)),
        class_shares=tuple(map(float, shares)),
        measures=tuple(map(float, measures)),
        codes=codes,
    )


def threshold(unit="drive", count=24, **changes):
    names = [f"{i:02}" for i in range(count)]
    population = tuple(traits(name, seed) for seed, name in enumerate(names))
    risk = RiskThreshold("error", 0.2, 0.1, None, count, tuple(names), unit)
    return replace(risk, population=population, data_set="choose", **changes)


def run(count=1, data_set="choose", **of_scans):
    """Return a comparison of scans of different drives."""
    root = Path("/data") / data_set / "sequences"
    files = [
        ScanFile(sequence=f"{i:02}", stem="0", path=root / f"{i:02}/velodyne/0.bin")
        for i in range(count)
    ]
    of_files = {file.name: traits(file.name, 100 + i, **of_scans) for i, file in enumerate(files)}
    return ThresholdComparison(files=files, sensor=SMALL, traits=of_files, classes=CLASSES)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_drives_like_those_of_the_threshold_differ_in_nothing(count):
    assert run(count).difference(threshold()) == ""
    assert run(count, data_set="other").difference(threshold()) == "", "drives cover other ones"


@pytest.mark.parametrize("count", [1, 2, 5])
def test_another_sensor_is_noticed_by_any_number_of_drives(count):
    problem = run(count, factor=2.0).difference(threshold())
    assert any(measure.name in problem for measure in MEASURES)


def test_a_new_warning_is_a_difference():
    assert "part-of-circle" in run(codes=("part-of-circle",)).difference(threshold())
    usual = tuple(replace(unit, codes=("part-of-circle",)) for unit in threshold().population)
    known = replace(threshold(), population=usual)
    assert run(codes=("part-of-circle",)).difference(known) == ""


def test_a_threshold_of_scans_covers_its_drives_only():
    risk = threshold("scan")
    assert run(2).difference(risk) == ""
    assert "choose" in run(2, data_set="check").difference(risk)
    assert "01" in run(2).difference(replace(risk, sequences=("00",)))
    # Early versions did not record the data set.
    assert run(2, data_set="check").difference(replace(risk, data_set=None)) == ""


def test_another_field_of_view_is_a_difference():
    view = FittedView.from_sensor(SMALL)
    risk = threshold()
    assert run().difference(replace(risk, views=(view,))) == ""
    other = replace(view, fov_up=view.fov_up + 8)
    assert "field of view" in run().difference(replace(risk, views=(other,)))


def test_a_threshold_of_an_early_version_is_compared_by_what_it_has():
    risk = threshold()
    early = replace(risk, population=tuple(replace(u, measures=()) for u in risk.population))
    assert run(5, factor=2.0).difference(early) == ""
    assert run(5, codes=("part-of-circle",)).difference(early) == ""
    assert run(5).difference(replace(risk, population=())) == ""
    assert why_incomparable(early, 5) == EARLY
    assert why_incomparable(replace(risk, population=()), 5) == EARLY


@pytest.mark.parametrize(
    ("chosen", "units", "reason"),
    # Of 25 drives, each one may be the most extreme; of 26 drives, 325 pairs.
    [
        (24, 1, "1 drive"),
        (24, 2, ""),
        (9, 2, "2 drives"),
        (9, 3, ""),
        (98, 1, "1 drive"),
        (99, 1, ""),
    ],
)
def test_few_drives_cannot_be_compared(chosen, units, reason):
    assert why_incomparable(threshold(count=chosen), units) == reason


def test_many_scans_can_be_compared():
    risk = threshold("scan", count=600)
    assert why_incomparable(risk, 600) == ""


@given(st.permutations(range(9)), st.integers(1, 9))
def test_a_sample_of_scans_does_not_depend_on_their_order(order, most):
    units = {f"{i // 3:02}/{i}": traits(str(i), i) for i in range(9)}
    names = list(units)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(threshold_scans, "MAX_COMPARED", most)
        in_order = TraitSample(traits=units)
        sample = TraitSample()
        for i in order:
            sample.add(names[i], units[names[i]])
        chosen = sample.chosen()
        assert chosen == in_order.chosen()
    assert len(chosen) == most
    assert chosen.items() <= units.items()
