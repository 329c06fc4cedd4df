# SPDX-License-Identifier: MIT
"""Number of columns told from values: simulated scans with what programs write beside them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salsanext_cli.formats.kitti import COUNTS, evident_count

VLP16_DEG = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
"""Elevations in the order of firing: every other beam looks up."""
BEAMS = 16


def scan(turns=1800, beams=VLP16_DEG, seed=0):
    """Simulate x, y, z of a scanner above flat ground, firing all beams at an azimuth."""
    random = np.random.default_rng(seed)
    azimuth, elevation = np.repeat(np.linspace(-np.pi, np.pi, turns), len(beams)), np.radians(beams)
    elevation = np.tile(elevation, turns)
    walls = random.uniform(5, 60, len(azimuth))
    down = np.minimum(1.8 / np.maximum(np.sin(-elevation), 1e-3), 40)
    ranges = np.where(elevation < 0, down, walls) * random.normal(1, 0.02, len(azimuth))
    flat = ranges * np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation)], 1)


def others(points, seed=1):
    """Return columns that programs write beside the coordinates, by name."""
    random, count = np.random.default_rng(seed), len(points)
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return {
        "fraction": random.random(count) ** 2,
        "byte": random.integers(0, 256, count),
        "decibel": -30 * random.random(count),
        "ring": np.arange(count) % BEAMS,
        "time": np.arange(count) * 1e-6,
        "one": np.ones(count),
        "zero": np.zeros(count),
        **{f"normal{i}": normals[:, i] for i in range(3)},
        **{f"colour{i}": random.integers(0, 256, count) for i in range(3)},
    }


def table(names, points):
    found = others(points)
    return np.column_stack([points, *(found[name] for name in names)]).astype(np.float32)


NORMALS, COLOURS = ("normal0", "normal1", "normal2"), ("colour0", "colour1", "colour2")
RECORDS = (
    (),
    ("fraction",),
    ("decibel",),
    ("ring", "fraction"),
    ("fraction", "time"),
    ("byte", "time", "ring", "zero", "zero"),
    ("fraction", *COLOURS, "time"),
    ("one", *NORMALS, "zero", "fraction", *["zero"] * 3),
    ("fraction", *["zero"] * 12),
)


def in_both_orders(rows):
    """Return the values of rows in their order, and shuffled."""
    return rows.ravel(), np.random.default_rng(2).permutation(rows).ravel()


@pytest.mark.parametrize("names", RECORDS, ids="-".join)
def test_a_wrong_number_of_columns_is_noticed_and_the_right_one_never(names):
    rows = table(names, scan())
    count = rows.shape[1]
    # Zeros are points without a return where the coordinates lie in the right columns.
    padded = names[1:2] == ("zero",)
    for values in in_both_orders(rows):
        assert evident_count(values, count) is None
        for expected in {4, 5} if padded else {*range(3, 8), 16}:
            # A multiple has every second point.
            if expected % count:
                assert evident_count(values, expected) == count, expected


@pytest.mark.parametrize("lost", [0.0, np.nan])
def test_points_without_a_return_change_nothing(lost):
    rows = table(("byte",), scan())
    rows[np.random.default_rng(3).random(len(rows)) < 0.7] = lost
    for values in in_both_orders(rows):
        assert evident_count(values, 4) is None
        assert evident_count(values, 5) == 4


def test_few_points_are_enough_or_nothing_is_said():
    points = np.random.default_rng(4).permutation(scan())
    for names in RECORDS:
        for count in (25, 50, 200):
            values = table(names, points[:count]).ravel()
            assert evident_count(values, 3 + len(names)) is None, names
            assert evident_count(values, 4) in {None, 3 + len(names)}, names


@given(hnp.arrays("<u4", st.integers(0, 300)), st.sampled_from([*COUNTS, 40]))
def test_any_bytes_have_some_number_of_columns_or_none(content, expected):
    found = evident_count(content.view("<f4"), expected)
    assert found is None or (found in COUNTS and found != expected)
