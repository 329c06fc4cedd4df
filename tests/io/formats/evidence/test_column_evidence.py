# SPDX-License-Identifier: MIT
"""The layout of values without a header, by the values."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import real_columns, real_scans

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats import kitti
from salsanext_cli.io.formats.evidence import column_evidence as evidence
from salsanext_cli.io.formats.evidence.column_measures import COUNTS
from salsanext_cli.io.formats.evidence.plane_evidence import are_planes


@pytest.mark.slow
@pytest.mark.real
def test_no_real_scan_in_another_order_is_refused(real_data):
    for path in real_scans(real_data)[::4]:
        count = real_columns(path)
        table = np.fromfile(path, "<f4").reshape(-1, count)
        shuffled = np.random.default_rng(0).permutation(table)
        for rows in (table, shuffled, table[: len(table) // 2], shuffled[:100]):
            assert evidence.evident_count(rows.ravel(), count) is None, path
            assert evidence.evident_count(rows.ravel(), 9 - count) in {count, None}, path
        assert evidence.evident_count(shuffled.ravel(), 9 - count) == count, path


VLP16_DEG = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
"""Elevations in the order of firing: every other beam looks up."""
BEAMS = 16


def scan(turns=1800, beams=VLP16_DEG, seed=0):
    """Return x, y, z of a scanner above flat ground, firing all beams at an azimuth."""
    return simulated(turns, tuple(beams), seed)


@cache
def simulated(turns, beams, seed):
    """Simulate such a scan, once for all tests, which do not change it."""
    random = np.random.default_rng(seed)
    azimuth, elevation = np.repeat(np.linspace(-np.pi, np.pi, turns), len(beams)), np.radians(beams)
    elevation = np.tile(elevation, turns)
    walls = random.uniform(5, 60, len(azimuth))
    down = np.minimum(1.8 / np.maximum(np.sin(-elevation), 1e-3), 40)
    ranges = np.where(elevation < 0, down, walls) * random.normal(1, 0.02, len(azimuth))
    flat = ranges * np.cos(elevation)
    axes = [flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation)]
    points = np.stack(axes, 1)
    points.flags.writeable = False
    return points


@cache
def others(count, seed=1):
    """Return columns that programs write beside the coordinates of points, by name."""
    random = np.random.default_rng(seed)
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
    found = others(len(points))
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
        assert evidence.evident_count(values, count) is None
        for expected in {4, 5} if padded else {*range(3, 8), 16}:
            if expected != count:
                assert evidence.evident_count(values, expected) == count, expected


@pytest.mark.parametrize("names", RECORDS, ids="-".join)
def test_a_multiple_of_the_columns_which_halves_the_points_is_noticed(names):
    """The simulated beams that look up and down in turn are of two kinds, so a ring follows."""
    rows = table(names, scan(beams=[*range(-25, 7)]))
    count = rows.shape[1]
    for values in in_both_orders(rows):
        for expected in range(2 * count, COUNTS.stop, count):
            assert evidence.evident_count(values, expected) == count, expected


@pytest.mark.slow
@pytest.mark.real
def test_a_multiple_of_the_columns_of_a_real_scan_is_noticed(real_data):
    for path in real_scans(real_data)[::4]:
        count = real_columns(path)
        rows = np.fromfile(path, "<f4").reshape(-1, count)
        normals = np.random.default_rng(1).normal(size=(len(rows), 3))
        shuffled = np.random.default_rng(0).permutation(rows)
        for points in (rows, shuffled):
            for times in range(2, 16 // count + 1):
                assert evidence.evident_count(points.ravel(), times * count) == count, path
            # Normals, zeros and colours beside the coordinates are no further points.
            for others in (normals, 0 * normals, np.abs(normals) * 99 // 1):
                wide = np.hstack([points[:, :3], others]).astype("<f4")
                assert evidence.evident_count(wide.ravel(), 6) is None, path


@pytest.mark.parametrize("lost", [0.0, np.nan])
def test_points_without_a_return_change_nothing(lost):
    rows = table(("byte",), scan())
    rows[np.random.default_rng(3).random(len(rows)) < 0.7] = lost
    for values in in_both_orders(rows):
        assert evidence.evident_count(values, 4) is None
        assert evidence.evident_count(values, 5) == 4


def test_few_points_are_enough_or_undecided():
    points = np.random.default_rng(4).permutation(scan())
    for names in RECORDS:
        for count in (25, 50, 200):
            values = table(names, points[:count]).ravel()
            assert evidence.evident_count(values, 3 + len(names)) is None, names
            assert evidence.evident_count(values, 4) in {None, 3 + len(names)}, names


@given(hnp.arrays("<u4", st.integers(0, 300)), st.sampled_from([*COUNTS, 40]))
def test_any_bytes_have_some_number_of_columns_or_none(content, expected):
    found = evidence.evident_count(content.view("<f4"), expected)
    assert found is None or (found in COUNTS and found != expected)


def wide_records(points, random):
    """Return records of eight columns that hold one point each, by what lies beside it."""
    size = np.linalg.norm(points, axis=1, keepdims=True)
    intensity = random.random((len(points), 1)) ** 2
    normals = random.normal(-points / size, 0.2)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    farther = points * random.choice([1, 1, 1.1, 1.5], (len(points), 1))
    nearer = points * (random.random((len(points), 1)) < 0.3)
    turned = points @ rotation_about_z(0.02) + (0.9, -0.1, 0.02)
    beside = {
        "normals": [normals, np.abs(random.normal(0, 0.01, intensity.shape))],
        "dual returns": [farther, intensity / 2],
        "dual returns or zeros": [nearer, intensity / 2],
        "moved": [points + (1.5, 0.2, 1.7), intensity],
        "turned": [turned, intensity],
    }
    return {name: np.hstack([points, intensity, *each]) for name, each in beside.items()}


def rotation_about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def require_wide_records_are_read(path, points):
    columns = ("x", "y", "z", "intensity", *"____")
    for name, rows in wide_records(points, np.random.default_rng(0)).items():
        for values in in_both_orders(rows.astype("<f4")):
            path.write_bytes(values.tobytes())
            found = kitti.read_bin(path, columns=columns)
            np.testing.assert_array_equal(found.points, values.reshape(-1, 8)[:, :3], name)
    # Rows of two points each, the second of which the columns would skip.
    pairs = table(("fraction",), points[: len(points) // 2 * 2])
    for values in in_both_orders(pairs):
        path.write_bytes(values.tobytes())
        with pytest.raises(FormatError, match="has 4 columns") as caught:
            kitti.read_bin(path, columns=columns)
        assert caught.value.hint == "omit columns"


def test_columns_beside_one_point_are_no_second_point(tmp_path):
    require_wide_records_are_read(tmp_path / "s.bin", scan(beams=[*range(-25, 7)]))


@pytest.mark.slow
@pytest.mark.real
def test_columns_beside_a_real_point_are_no_second_point(real_data, tmp_path):
    for path in real_scans(real_data)[::8]:
        points = np.fromfile(path, "<f4").reshape(-1, real_columns(path))[:, :3]
        measured = points[points.any(axis=1)].astype(float)
        require_wide_records_are_read(tmp_path / "s.bin", measured)


def stored_by_column(rows):
    """Return the values of rows column after column."""
    columns = [rows[:, column] for column in range(rows.shape[1])]
    return np.concatenate(columns).astype(np.float32)


@pytest.mark.parametrize("names", RECORDS[1:4], ids="-".join)
@pytest.mark.parametrize("beams", [VLP16_DEG, [*range(-25, 7)]], ids=["alternating", "sorted"])
def test_values_stored_column_by_column_are_recognised_and_rows_never(names, beams):
    rows = table(names, scan(turns=360, beams=beams))
    count = rows.shape[1]
    for order in in_both_orders(rows):
        values = order.reshape(-1, count)
        for expected in (3, 4, 5):
            fits = are_planes(stored_by_column(values), expected)
            assert fits == (expected == count)
            assert are_planes(order, expected) is None


def require_layouts_are_never_confused(points, intensity):
    """Require that each layout of a scan is read as it is, or refused, in four columns."""
    axes = points[: len(points) // 12 * 12].astype(np.float32)
    four = np.column_stack([axes, intensity[: len(axes)]]).astype(np.float32)
    assert are_planes(four.ravel(), 4) is None
    assert evidence.evident_count(four.ravel(), 4) is None
    assert are_planes(np.ascontiguousarray(four.T).ravel(), 4) is not None
    assert are_planes(axes.ravel(), 4) is None
    assert evidence.evident_count(axes.ravel(), 4) == 3
    shuffled = np.random.default_rng(0).permutation(axes)
    for planes in (axes.T, shuffled.T):
        assert not are_planes(np.ascontiguousarray(planes).ravel(), 4)


@pytest.mark.parametrize("beams", [VLP16_DEG, [*range(-25, 7)]], ids=["alternating", "sorted"])
@pytest.mark.parametrize("height", [0, 1.8, -3])
@pytest.mark.parametrize("turns", [360, 1800])
def test_coordinates_alone_are_not_read_with_an_intensity(beams, height, turns):
    points = scan(turns=turns, beams=beams) + (0, 0, height)
    intensity = np.random.default_rng(1).random(len(points)) ** 2
    require_layouts_are_never_confused(points, intensity)
    four = np.column_stack([points, intensity])
    assert are_planes(stored_by_column(four), 4)


@pytest.mark.slow
@pytest.mark.real
def test_coordinates_alone_of_a_real_scan_are_not_read_with_an_intensity(real_data):
    for path in real_scans(real_data)[::4]:
        table = np.fromfile(path, "<f4").reshape(-1, real_columns(path))
        require_layouts_are_never_confused(table[:, :3], table[:, 3])


@pytest.mark.parametrize(
    ("before", "after"), [(0.5, 0), (1, 0), (2, 0), (0.3, 0.3), (1, 1), (0, 2)]
)
@pytest.mark.parametrize("empty", [(0, 0, 0, 0), [np.nan] * 4, [np.nan] * 3 + [0]])
@pytest.mark.parametrize("shuffled", [False, True])
def test_rows_without_a_point_at_the_ends_are_no_columns(tmp_path, before, after, empty, shuffled):
    rows = table(("fraction",), scan(beams=[*range(-25, 7)]))
    if shuffled:
        rows = np.random.default_rng(0).permutation(rows)
    parts = [
        np.tile(np.array(empty, np.float32), (round(n * len(rows)), 1)) for n in (before, after)
    ]
    filled = np.concatenate([parts[0], rows, parts[1]])
    path = tmp_path / "s.bin"
    path.write_bytes(filled.tobytes())
    np.testing.assert_array_equal(kitti.read_bin(path).points, filled[:, :3])


def test_standardised_intensities_are_read_if_they_are_named(tmp_path):
    points = even_scan()
    intensity = np.random.default_rng(8).normal(0, 8, len(points))
    path = tmp_path / "s.bin"
    rows = np.column_stack([points, intensity]).astype(np.float32)
    path.write_bytes(rows.tobytes())
    with pytest.raises(FormatError) as caught:
        kitti.read_bin(path)
    names = ("x", "y", "z", "intensity")
    assert f'columns="{",".join(names)}" if' in caught.value.hint
    np.testing.assert_array_equal(kitti.read_bin(path, names).points, rows[:, :3])


@pytest.mark.parametrize("shift", [(0, 0, 0), (24, 18, 3), (-300, 120, 10)])
@pytest.mark.parametrize("padding", [0.02, 0.3, 0.5])
@pytest.mark.parametrize("shuffled", [False, True])
def test_rows_of_zeros_at_the_end_are_no_columns(shift, padding, shuffled):
    """As of arrays of a fixed size, of which a program filled a part."""
    rows = table(("fraction",), scan(beams=[*range(-25, 7)]) + shift)
    if shuffled:
        rows = np.random.default_rng(0).permutation(rows)
    filled = np.concatenate([rows, np.zeros((round(padding * len(rows)), 4), np.float32)])
    assert are_planes(filled.ravel(), 4) is None
    assert evidence.evident_count(filled.ravel(), 4) is None
    # Intensities of zero follow the coordinates of planes.
    dark = table(("zero",), scan(turns=360) + shift)
    assert are_planes(stored_by_column(dark), 4)


EVEN_WALLS = np.random.default_rng(5).uniform(1, 40, (20_000, 1))


def even_scan():
    """Simulate x, y, z around a sensor that sees about the same in all directions."""
    random = np.random.default_rng(6)
    directions = random.normal(size=(len(EVEN_WALLS), 3))
    return EVEN_WALLS * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_shuffled_coordinates_stored_by_column_are_not_read_with_an_intensity(tmp_path):
    path, points = tmp_path / "s.bin", even_scan().astype(np.float32)
    path.write_bytes(np.ascontiguousarray(points.T).tobytes())
    with pytest.raises(FormatError, match="coordinates") as caught:
        kitti.read_bin(path)
    hint = caught.value.hint
    assert 'columns="x,y,z,_"' in hint
    # The hint works when it is followed.
    expression = hint.partition("(FILE, np.float32)")[2].partition(".tofile")[0]
    assert expression == ".reshape(COLUMNS, -1).T"
    np.testing.assert_array_equal(np.fromfile(path, np.float32).reshape(3, -1).T, points)
    assert len(kitti.read_bin(path, columns=("x", "y", "z", "_"))) == len(points) * 3 // 4


def test_the_hint_has_as_many_names_as_a_file_with_rings_has_columns(tmp_path):
    path, points = tmp_path / "s.pcd.bin", even_scan()[:19_000].astype(np.float32)
    path.write_bytes(np.ascontiguousarray(points.T).tobytes())
    with pytest.raises(FormatError, match="coordinates") as caught:
        kitti.read_bin(path)
    names = caught.value.hint.rpartition('columns="')[2].removesuffix('"').split(",")
    assert len(kitti.read_bin(path, columns=tuple(names))) == len(points) * 3 // 5


@pytest.mark.parametrize("fourth", [0.01, 1.0, 255.0])
def test_a_fourth_column_of_both_signs_is_read_if_it_differs(tmp_path, fourth):
    path, points = tmp_path / "s.bin", even_scan()
    rows = np.column_stack([points, np.random.default_rng(7).normal(0, fourth, len(points))])
    path.write_bytes(rows.astype(np.float32).tobytes())
    assert len(kitti.read_bin(path)) == len(points)


@pytest.mark.real
def test_shuffled_coordinates_of_a_real_scan_stored_by_column_are_refused(real_data, tmp_path):
    path = tmp_path / "s.bin"
    for scan_path in real_scans(real_data)[::10]:
        points = np.fromfile(scan_path, "<f4").reshape(-1, real_columns(scan_path))[:, :3]
        points = np.random.default_rng(0).permutation(points[points.any(axis=1)])
        path.write_bytes(np.ascontiguousarray(points[: len(points) // 4 * 4].T).tobytes())
        with pytest.raises(FormatError):
            kitti.read_bin(path)


@pytest.mark.parametrize("period", [2, 3, 4])
@pytest.mark.parametrize("lost", [0.0, np.nan, np.inf])
def test_places_of_rows_that_are_always_empty(period, lost):
    rows = table(("byte",), scan(turns=360))
    places = np.arange(period) == period - 1
    rows[period - 1 :: period] = lost
    rows = rows[: len(rows) // period * period]
    np.testing.assert_array_equal(evidence.empty_places(rows.ravel(), 4), places)
    for values in (rows.ravel(), np.random.default_rng(0).permutation(rows).ravel()):
        assert evidence.evident_count(values, 4) is None
    # One measured point at each place is enough.
    rows[-4:] = 1
    assert evidence.empty_places(rows.ravel(), 4) is None


@pytest.mark.slow
@pytest.mark.real
def test_no_real_scan_is_taken_for_planes_and_its_transpose_is(real_data):
    right = []
    for path in real_scans(real_data)[::4]:
        count = real_columns(path)
        rows = np.fromfile(path, "<f4").reshape(-1, count)
        assert are_planes(rows.ravel(), count) is None, path
        # A wrong number is refused with a hint; a right one may be refused too.
        fits = are_planes(np.ascontiguousarray(rows.T).ravel(), count)
        right.append(fits)
        assert fits is not None, path
        wrong = are_planes(np.ascontiguousarray(rows.T).ravel(), 9 - count)
        assert not wrong, path
    assert np.mean(right) > 0.9
