# SPDX-License-Identifier: MIT
"""Headerless files: scans with any number of columns, labels, and other files."""

import gzip
import io
import re
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import make_scan

from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats import kitti


@pytest.mark.parametrize("count", [40, 41, 42, 43])
@pytest.mark.parametrize(("columns", "suffix"), [(5, ".bin"), (4, ".pcd.bin")])
def test_another_number_of_columns_is_recognised(tmp_path, count, columns, suffix):
    path = tmp_path / f"s{suffix}"
    random = np.random.default_rng(count)
    table = [random.normal(0, 20, (count, 3)), *random.integers(0, (256, 32), (1, count, 2))]
    path.write_bytes(np.hstack(table).astype("<f4")[:, :columns].tobytes())
    with pytest.raises(FormatError) as caught:
        kitti.read_bin(path)
    assert caught.value.hint.startswith(f"rename it to {'.pcd.bin' if columns == 5 else '.bin'},")


def test_negative_intensities_and_signalling_nans_are_read(tmp_path):
    table = np.random.default_rng(0).normal(0, 20, (59, 4)).astype("<f4")
    nan = struct.pack("<3f", 1, 2, 3) + b"\x01\x00\xa0\x7f"
    (tmp_path / "s.bin").write_bytes(table.tobytes() + nan)
    scan = kitti.read_bin(tmp_path / "s.bin", intensity_scale=255)
    assert np.flatnonzero(np.isnan(scan.intensity)).tolist() == [59]


def real_scans(real_data):
    """Return the `.bin` files, without those that are no scans."""
    found = sorted((real_data / "data").rglob("*.bin"))
    return [path for path in found if "not_scans" not in path.parts]


@pytest.mark.real
def test_no_real_scan_is_refused(real_data, tmp_path):
    for path in real_scans(real_data):
        columns = 5 if "five" in path.name else 4
        link = tmp_path / f"{len(list(tmp_path.iterdir()))}{'.pcd' * (columns == 5)}.bin"
        link.symlink_to(path)
        scan = kitti.read_bin(link)
        assert len(scan) == path.stat().st_size // (4 * columns)
        labels = path.parent.parent / "labels" / f"{path.stem}.label"
        if labels.exists():
            raw = kitti.read_labels(labels, len(scan))
            assert raw.any()
            assert raw.max() < 33 or "nuscenes" not in str(path)


@pytest.mark.real
@pytest.mark.parametrize("name", ["semantickitti/sequences/00", "pandaset/sequences/002"])
def test_a_real_scan_with_other_columns_is_refused_with_names_to_try(real_data, tmp_path, name):
    table = np.fromfile(next((real_data / "data" / name / "velodyne").iterdir()), "<f4")
    table = table.reshape(-1, 4)
    random, ones = np.random.default_rng(0), np.ones((len(table), 1), np.float32)
    normals = random.normal(size=(len(table), 3))
    path = tmp_path / "s.bin"
    for columns in (
        [table[:, :3]],
        [table, normals],
        [table, random.integers(0, 256, (len(table), 3)), ones],
        [table[:, :3], ones, table[:, 3:], 0 * normals],
        [table, 0 * ones, np.arange(len(table))[:, None] % 64, 0 * normals],
    ):
        path.write_bytes(np.hstack(columns).astype("<f4").tobytes())
        with pytest.raises(FormatError) as caught:
            kitti.read_bin(path)
        (names,) = re.findall(r"--columns (\S+)", caught.value.hint)
        scan = kitti.read_bin(path, columns=tuple(names.split(",")))
        np.testing.assert_array_equal(scan.points, table[:, :3])


@pytest.mark.real
def test_no_real_scan_in_another_order_is_refused(real_data):
    for path in real_scans(real_data)[::4]:
        count = 5 if "five" in path.name else 4
        table = np.fromfile(path, "<f4").reshape(-1, count)
        shuffled = np.random.default_rng(0).permutation(table)
        for rows in (table, shuffled, table[: len(table) // 2], shuffled[:100]):
            assert kitti.evident_count(rows.ravel(), count) is None, path
            assert kitti.evident_count(rows.ravel(), 9 - count) in {count, None}, path
        assert kitti.evident_count(shuffled.ravel(), 9 - count) == count, path


@given(hnp.arrays(np.uint32, st.integers(0, 50)))
def test_labels_survive_the_round_trip(tmp_path_factory, raw):
    path = tmp_path_factory.mktemp("label") / "s.label"
    kitti.write_labels(path, raw)
    assert path.read_bytes() == b"".join(struct.pack("<I", value) for value in raw.tolist())
    np.testing.assert_array_equal(kitti.read_labels(path, len(raw)), raw)
    with pytest.raises(LabelError, match=rf"{len(raw)} labels? \(expected {len(raw) + 53}"):
        kitti.read_labels(path, len(raw) + 53)
    path.write_bytes(path.read_bytes() + b"cut")
    with pytest.raises(FormatError, match=f"{4 * len(raw) + 3} bytes"):
        kitti.read_labels(path)


@pytest.mark.parametrize("kind", ["<u4", "<u2", "u1"])
def test_labels_of_one_two_or_four_bytes(tmp_path, kind):
    path = tmp_path / "s.label"
    raw = np.arange(100, dtype=kind)
    path.write_bytes(raw.tobytes())
    read = kitti.read_labels(path, 100)
    assert read.dtype == np.uint32
    np.testing.assert_array_equal(read, raw)
    with pytest.raises(LabelError, match=r"\d+ labels \(expected 99"):
        kitti.read_labels(path, 99)
    if raw.itemsize < 4:
        path.write_bytes(np.arange(25 * raw.itemsize, dtype="<u4").tobytes())
        with pytest.raises(LabelError, match=r"\d+ labels \(expected 100"):
            kitti.read_labels(path, 100)
        path.write_bytes(bytes(100 * raw.itemsize))
        assert not kitti.read_labels(path, 100).any()
    path.write_bytes(raw.tobytes())
    # Without the number of points they are four.
    assert len(kitti.read_labels(path)) == raw.nbytes // 4


SCAN = make_scan(3000)
TABLE = np.column_stack([SCAN.points, SCAN.intensity])
RING = np.arange(3000)[:, None] % 64


def npy(table):
    with io.BytesIO() as file:
        np.save(file, table)
        return file.getvalue()


LINES = "".join(f"{x:.3f} {y:.3f} {z:.3f} {i:.2f}\n" for x, y, z, i in TABLE).encode()
OTHERS = {
    "empty": (b"", "is empty"),
    "text": (LINES[: len(LINES) // 16 * 16], "is text"),
    "a short text": ("Grüße aus Köln!\n".encode() * 16, "is text"),
    "ply": (b"ply\nformat binary_little_endian 1.0\n" + bytes(16 * 99), "is a .ply file"),
    "npy": (npy(TABLE), "is a .npy file"),
    "gzip": (gzip.compress(kitti.encode_bin(SCAN)), "is a gzip file"),
    "float64": (TABLE.astype("<f8").tobytes(), "float64"),
    "float64, decimals": (TABLE.astype("<f8").round(3).tobytes(), "float64"),
    "float64, dyadic": (np.rint(TABLE.astype("<f8") * 128) / 128, "float64"),
    "float64, five columns": (np.hstack([TABLE, RING]).astype("<f8").tobytes(), "float64"),
    "millimetres as int32": ((TABLE * 1000).astype("<i4").tobytes(), "not coordinates"),
    "big endian": (TABLE.astype(">f4").tobytes(), "not coordinates"),
    "random": (np.random.default_rng(0).bytes(48_000), "not coordinates"),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("columns", [(), ("x", "y", "z", "intensity")])
def test_other_content_is_refused(tmp_path, name, columns):
    content, problem = OTHERS[name]
    path = tmp_path / "s.bin"
    path.write_bytes(content if isinstance(content, bytes) else content.tobytes())
    with pytest.raises(FormatError) as caught:
        kitti.read_bin(path, columns=columns)
    assert problem in caught.value.problem
    assert "\n" not in caught.value.headline


UNUSUAL = {
    "nothing measured": np.zeros((500, 4)),
    "two thirds zeros": np.where(np.random.default_rng(1).random((3000, 1)) < 2 / 3, 0, TABLE),
    "one plane": TABLE * [1, 1, 0, 1],
    "millimetres": TABLE * 1000,
    "UTM": TABLE + [5e5, 5.6e6, 0, 0],
    "one point": TABLE[:1],
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_points_are_read(tmp_path, name):
    path = tmp_path / "s.bin"
    table = UNUSUAL[name].astype("<f4")
    path.write_bytes(table.tobytes())
    np.testing.assert_array_equal(kitti.read_bin(path).points, table[:, :3])


def test_any_columns(tmp_path):
    path = tmp_path / "s.bin"
    table = np.hstack([RING, TABLE[:, 3:] * 255, TABLE[:, :3], -TABLE[:, :2]]).astype("<f4")
    path.write_bytes(table.tobytes())
    names = ("ring", "intensity", "x", "y", "z", "_", "_")
    scan = kitti.read_bin(path, columns=names, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_allclose(scan.intensity, SCAN.intensity, rtol=1e-6)
    for columns, cut, sizes in (((*names, "_", "_"), 0, (7, 9)), (names, 4, (83996, 28))):
        path.write_bytes(table.tobytes()[: table.nbytes - cut])
        with pytest.raises(FormatError, match=r"{}.*expected .*{}".format(*sizes)):
            kitti.read_bin(path, columns=columns)
    path.write_bytes(SCAN.points.tobytes())
    assert not kitti.read_bin(path, columns=("x", "y", "z")).intensity.any()


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
        assert kitti.evident_count(values, count) is None
        for expected in {4, 5} if padded else {*range(3, 8), 16}:
            if expected != count:
                assert kitti.evident_count(values, expected) == count, expected


@pytest.mark.parametrize("names", RECORDS, ids="-".join)
def test_a_multiple_of_the_columns_which_halves_the_points_is_noticed(names):
    """The simulated beams that look up and down in turn are of two kinds, so a ring follows."""
    rows = table(names, scan(beams=[*range(-25, 7)]))
    count = rows.shape[1]
    for values in in_both_orders(rows):
        for expected in range(2 * count, kitti.COUNTS.stop, count):
            assert kitti.evident_count(values, expected) == count, expected


@pytest.mark.real
def test_a_multiple_of_the_columns_of_a_real_scan_is_noticed(real_data):
    for path in real_scans(real_data)[::4]:
        count = 5 if "five" in path.name else 4
        rows = np.fromfile(path, "<f4").reshape(-1, count)
        normals = np.random.default_rng(1).normal(size=(len(rows), 3))
        shuffled = np.random.default_rng(0).permutation(rows)
        for points in (rows, shuffled):
            for times in range(2, 16 // count + 1):
                assert kitti.evident_count(points.ravel(), times * count) == count, path
            # Normals, zeros and colours beside the coordinates are no further points.
            for others in (normals, 0 * normals, np.abs(normals) * 99 // 1):
                wide = np.hstack([points[:, :3], others]).astype("<f4")
                assert kitti.evident_count(wide.ravel(), 6) is None, path


@pytest.mark.parametrize("lost", [0.0, np.nan])
def test_points_without_a_return_change_nothing(lost):
    rows = table(("byte",), scan())
    rows[np.random.default_rng(3).random(len(rows)) < 0.7] = lost
    for values in in_both_orders(rows):
        assert kitti.evident_count(values, 4) is None
        assert kitti.evident_count(values, 5) == 4


def test_few_points_are_enough_or_undecided():
    points = np.random.default_rng(4).permutation(scan())
    for names in RECORDS:
        for count in (25, 50, 200):
            values = table(names, points[:count]).ravel()
            assert kitti.evident_count(values, 3 + len(names)) is None, names
            assert kitti.evident_count(values, 4) in {None, 3 + len(names)}, names


@given(hnp.arrays("<u4", st.integers(0, 300)), st.sampled_from([*kitti.COUNTS, 40]))
def test_any_bytes_have_some_number_of_columns_or_none(content, expected):
    found = kitti.evident_count(content.view("<f4"), expected)
    assert found is None or (found in kitti.COUNTS and found != expected)


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
        assert caught.value.hint == "omit --columns"


def test_columns_beside_one_point_are_no_second_point(tmp_path):
    require_wide_records_are_read(tmp_path / "s.bin", scan(beams=[*range(-25, 7)]))


@pytest.mark.real
def test_columns_beside_a_real_point_are_no_second_point(real_data, tmp_path):
    for path in real_scans(real_data)[::8]:
        points = np.fromfile(path, "<f4").reshape(-1, 5 if "five" in path.name else 4)[:, :3]
        measured = points[points.any(axis=1)].astype(float)
        require_wide_records_are_read(tmp_path / "s.bin", measured)
