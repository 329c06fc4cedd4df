# SPDX-License-Identifier: MIT
"""LAS and LAZ, compared with what laspy reads and writes by itself."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import make_scan

from salsanext_cli import label_space, read_scan
from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError, MissingDependency, OutputError
from salsanext_cli.files.reading import PANIC
from salsanext_cli.formats.las import asprs_class, classification, encode_las

laspy = pytest.importorskip("laspy")
lazrs = pytest.importorskip("lazrs")
SUFFIXES = (".las", ".laz")


def columns_of(points, intensity):
    count = len(points)
    colours = {name: np.arange(count).astype(np.uint8) for name in ("red", "green", "blue")}
    scalars = {"intensity": intensity, "label": np.arange(count).astype(np.uint16)}
    scalars |= {"error": np.full(count, np.nan, np.float32), "total": points[:, 0] * np.float32(3)}
    return dict(zip("xyz", points.T, strict=True)) | colours | scalars


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(st.integers(0, 300), st.sampled_from([1e-3, 1.0, 63.9, 64.0, 9999.0]), st.integers(0, 5))
def test_what_is_written_is_read_again(tmp_path_factory, suffix, count, size, seed):
    path = tmp_path_factory.mktemp("las") / f"s{suffix}"
    scan = make_scan(count, seed)
    farthest = max(1e-9, np.abs(scan.points).max(initial=0))
    points = (scan.points.astype(np.float64) / farthest * size).astype(np.float32)
    columns = columns_of(points, scan.intensity * 3 - 1)
    classes = np.arange(count).astype(np.uint8)
    path.write_bytes(encode_las(path, columns, classes, ["colour label", "class 2 ground"]))
    read = read_scan(path)
    # Half of the last of 31 bits.
    np.testing.assert_allclose(read.points, points, rtol=0, atol=2 * size * 2.0**-32)
    np.testing.assert_array_equal(read.intensity, columns["intensity"])
    cloud = laspy.read(path)
    np.testing.assert_array_equal(cloud.classification, classes)
    for name in ("label", "error", "total"):
        np.testing.assert_array_equal(cloud[name], columns[name])
        assert cloud[name].dtype == columns[name].dtype
    np.testing.assert_array_equal(cloud.red, columns["red"] * np.uint16(257))
    share = np.clip(columns["intensity"], 0, 1)
    assert np.abs(cloud.intensity / 65535 - share).max(initial=0) < 1e-5
    assert cloud.vlrs[0].record_data == b"colour label\nclass 2 ground"
    assert cloud.header.creation_date is None
    assert cloud.header.are_points_compressed == (suffix == ".laz")


def test_points_without_a_measurement_are_withheld(tmp_path):
    path = tmp_path / "s.las"
    points = np.float32([[1, 2, 3], [np.nan, 1, 1], [0, 0, 0], [1, np.inf, 1]])
    path.write_bytes(encode_las(path, columns_of(points, np.float32([0, np.nan, 1, np.inf])),
                                np.zeros(4, np.uint8)))  # fmt: skip
    assert np.array(laspy.read(path).withheld).tolist() == [False, True, False, True]
    assert read_scan(path).points.tolist() == [[1, 2, 3], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    points[2, 0] = 10_001
    with pytest.raises(OutputError, match=r"a point at 10001 m .* export with --format ply"):
        encode_las(path, columns_of(points, points[:, 0]), np.zeros(4, np.uint8))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", [0, 3, 8])
def test_point_formats_of_other_programs(tmp_path, suffix, kind):
    scan = make_scan(700)
    cloud = laspy.create(point_format=kind)
    cloud.header.scales, cloud.header.offsets = np.full(3, 1e-3), np.array([5, -7, 100])
    cloud.x, cloud.y, cloud.z = scan.points.T
    cloud.intensity = scan.intensity * 65535
    cloud.write(tmp_path / f"s{suffix}")
    read = read_scan(tmp_path / f"s{suffix}")
    assert np.abs(read.points - scan.points).max() < 0.51e-3
    assert np.abs(read.intensity - scan.intensity).max() < 2e-5


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_maps_and_damaged_files_are_refused(tmp_path, suffix):
    path = tmp_path / f"s{suffix}"
    cloud = laspy.create()
    cloud.x, cloud.y, cloud.z = np.array([[5e5, 5.6e6, 100], [5e5 + 1, 5.6e6, 100]]).T
    cloud.write(path)
    with pytest.raises(FormatError, match=r"x from 500000 to 500001, as of a map .* subtract"):
        read_scan(path)
    cloud = laspy.create()
    cloud.x = cloud.y = cloud.z = np.random.default_rng(0).normal(0, 9, 5000)
    cloud.write(path)
    content = path.read_bytes()
    for length in (len(content) // 2, 300, 100, 4, 0):
        path.write_bytes(content[:length])
        with pytest.raises(FormatError, match="damaged or cut off") as caught:
            read_scan(path)
        assert "\n" not in str(caught.value)


def test_a_panic_of_lazrs_is_a_damaged_file(tmp_path):
    path = tmp_path / "s.laz"
    cloud = laspy.create(point_format=6)
    cloud.x = cloud.y = cloud.z = np.random.default_rng(0).normal(0, 9, 10)
    cloud.write(path)
    with laspy.open(path) as file:
        data = file.point_source.vlr.record_data()
    path.write_bytes(path.read_bytes().replace(data, data[:32] + b"\0\0" + data[34:]))
    with pytest.raises(BaseException, match="at least one LazItem") as caught:
        laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
    assert type(caught.value).__name__ == PANIC
    with pytest.raises(FormatError, match=r"cut off: .* at least one LazItem"):
        read_scan(path)


GEOGRAPHIC = 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.25]]]'
PROJECTED = f'PROJCS["WGS 84 / UTM 32N",{GEOGRAPHIC},UNIT["metre",1]]'


def with_keys(model):
    """Return a record of keys: the kind of the coordinate system and its number."""
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, model, 2048, 0, 1, 4326], "<u2")
    return laspy.VLR("LASF_Projection", 34735, "", keys.tobytes())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_coordinates_in_degrees_are_refused_and_projected_ones_read(tmp_path, suffix):
    path = tmp_path / f"s{suffix}"
    for record, in_degrees in (
        (with_keys(2), True),
        (with_keys(1), False),
        (laspy.VLR("LASF_Projection", 2112, "", GEOGRAPHIC.encode()), True),
        (laspy.VLR("LASF_Projection", 2112, "", PROJECTED.encode()), False),
    ):
        cloud = laspy.create()
        cloud.vlrs.append(record)
        cloud.x = cloud.y = cloud.z = np.arange(9.0)
        cloud.write(path)
        if in_degrees:
            with pytest.raises(
                FormatError, match=r"in degrees, .* expected metres .* project them"
            ):
                read_scan(path)
        else:
            assert len(read_scan(path)) == 9


def test_a_newer_version_is_named(tmp_path):
    path = tmp_path / "s.laz"
    laspy.create().write(path)
    content = path.read_bytes()
    path.write_bytes(content[:24] + b"\1\5" + content[26:])
    with pytest.raises(FormatError, match=r"LAS 1\.5 \(expected LAS 1\.0 to 1\.4\)\nhint: convert"):
        read_scan(path)


@pytest.mark.parametrize(
    ("name", "suffix"), [("laspy", ".laz"), ("lazrs", ".laz"), ("lazrs", ".las")]
)
def test_a_missing_package_is_named_with_the_file(tmp_path, monkeypatch, name, suffix):
    path = tmp_path / f"drive{suffix}"
    laspy.create().write(tmp_path / "s.laz")
    (tmp_path / "s.laz").rename(path)
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingDependency) as caught:
        read_scan(path)
    assert str(caught.value) == f"{path}: LAS needs {name}\nhint: pip install 'salsanext[las]'"


def test_classes_of_the_asprs():
    space = label_space()
    expected = {0: 1, 1: 7, 10: 74, 252: 74, 253: 95, 40: 11, 60: 11, 48: 2, 70: 5, 50: 6, 81: 145}
    assert {raw: asprs_class(raw, space) for raw in expected} == expected
    # Every class that is predicted has one, and unlabelled alone has none.
    predicted = space.to_raw(np.arange(space.class_count))
    assert (classification(predicted, space) == 1).tolist() == [True, *[False] * 19]
    own = {"labels": {0: "no", 3: "road", 7: "ski", 500: "lift"}, "name": "own"}
    own |= {
        "learning_map": {0: 0, 3: 1, 7: 2, 500: 3},
        "learning_map_inv": {0: 0, 1: 3, 2: 7, 3: 500},
    }
    raw = np.uint32([3, 7, 500, 9, 3])
    assert classification(raw, LabelSpace.from_dict(own)).tolist() == [11, 71, 1, 1, 11]
    assert not len(classification(raw[:0], space))
