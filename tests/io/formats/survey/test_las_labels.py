# SPDX-License-Identifier: MIT
"""LAS files with labels, opened again by laspy."""

import numpy as np
import pytest
from las_files import write_las
from scans import make_scan, refused, write_bin

from salsanext_cli import Scan, label_space, read_scan
from salsanext_cli.core.classes.asprs import names_of_codes
from salsanext_cli.core.errors import LabelError
from salsanext_cli.io.formats.survey.las_labels import WITH_256_CLASSES, LasLabels, labelled_las

laspy = pytest.importorskip("laspy")
SPACE = label_space()
SCAN = make_scan(300)
RAW = np.random.default_rng(0).choice([0, 10, 40, 48, 50, 70, 81, 252, 777], 300).astype(np.uint32)
ERROR = np.random.default_rng(1).random(300).astype(np.float32)
CODES = {0: 1, 10: 74, 40: 11, 48: 2, 50: 6, 70: 5, 81: 145, 252: 74, 777: 1}
UTM = (500_123.4, 5_400_456.7, 312.0)


def labels(**values):
    values = {"label": RAW.astype(np.uint16), "error": ERROR, **values}
    return LasLabels(codes=SPACE.asprs_codes, names=names_of_codes(SPACE), raw=RAW, values=values)


def opened(folder, path, scan, *, compressed=False, **values):
    target = folder / ("out.laz" if compressed else "out.las")
    target.write_bytes(labelled_las(path, scan, labels(**values), compressed=compressed))
    cloud = laspy.read(target)
    assert cloud.header.are_points_compressed == compressed
    np.testing.assert_array_equal(cloud.classification, [CODES[raw] for raw in RAW.tolist()])
    np.testing.assert_array_equal(cloud["label"], RAW)
    np.testing.assert_array_equal(cloud["error"], ERROR)
    return cloud


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", range(11))
def test_a_scan_in_las_keeps_points_and_fields(tmp_path, kind, compressed):
    angles = {"scan_angle_rank": (np.arange(300) % 90 - 45).astype(np.int8)}
    if kind > 5:
        angles = {"scan_angle": (np.arange(300) % 90 - 45).astype(np.int16) * 100}
    path = write_las(
        tmp_path / "s.las",
        SCAN.points + np.array(UTM),
        np.arange(300, dtype=np.uint16),
        kind=kind,
        offsets=UTM,
        extra={"echo": ERROR},
        point_source_id=np.arange(300, dtype=np.uint16),
        **angles,
    )
    cloud = opened(tmp_path, path, read_scan(path), compressed=compressed)
    own = laspy.read(path)
    assert cloud.point_format.id == WITH_256_CLASSES.get(kind, kind)
    for name in ("X", "Y", "Z", "intensity", "point_source_id", "echo"):
        np.testing.assert_array_equal(cloud[name], own[name])
    if kind > 5:
        np.testing.assert_array_equal(cloud.scan_angle, own.scan_angle)
    else:
        np.testing.assert_allclose(cloud.scan_angle * 0.006, own.scan_angle_rank, atol=0.003)
    np.testing.assert_array_equal(cloud.header.offsets, own.header.offsets)


def test_labels_that_a_file_has_already_are_replaced(tmp_path):
    path = write_las(tmp_path / "s.las", SCAN.points, extra={"label": np.ones(300)})
    cloud = opened(tmp_path, path, read_scan(path))
    assert sorted(cloud.point_format.extra_dimension_names) == ["error", "label"]


def test_any_other_scan_becomes_a_new_file_that_depends_on_it_alone(tmp_path):
    points = SCAN.points.copy()
    points[:3] = [[np.nan, 1, 1], [0, 0, 0], [1e9, 0, 0]]
    scan = Scan(points, SCAN.intensity)
    path = tmp_path / "s.bin"
    write_bin(path, scan)
    cloud = opened(tmp_path, path, scan)
    np.testing.assert_array_equal(np.flatnonzero(cloud.withheld), [0, 1, 2])
    np.testing.assert_allclose(cloud.xyz[3:], points[3:], atol=0.51e-4)
    np.testing.assert_allclose(cloud.intensity / 65535, SCAN.intensity, atol=1e-5)
    assert (tmp_path / "out.las").read_bytes()[90:94] == bytes(4)  # Day of creation
    again = read_scan(tmp_path / "out.las")
    np.testing.assert_array_equal(np.isnan(again.points).all(axis=1), cloud.withheld)


def test_the_record_of_the_classes_names_them(tmp_path):
    record = labels().lookup()
    assert len(record) == 256 * 16
    rows = [record[start : start + 16] for start in range(0, len(record), 16)]
    assert [row[0] for row in rows] == [*range(256)]
    names = {row[0]: row[1:].rstrip(b"\0").decode() for row in rows}
    assert (names[74], names[6], names[144], names[200]) == ("car", "building", "pole", "")
    # Several classes have these codes.
    assert (names[2], names[11]) == ("Ground", "Road Surface")
    path = write_las(tmp_path / "s.las", SCAN.points)
    cloud = opened(tmp_path, path, read_scan(path))
    (lookup,) = [v for v in cloud.vlrs if (v.user_id, v.record_id) == ("LASF_Spec", 0)]
    assert (lookup[74], lookup[80]) == ("car", "on rails")


def test_labels_of_other_points_are_refused(tmp_path):
    path = write_las(tmp_path / "s.las", SCAN.points[1:])
    with refused(LabelError, path):
        labelled_las(path, read_scan(path), labels(), compressed=False)
