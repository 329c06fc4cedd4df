# SPDX-License-Identifier: MIT
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats import kitti, read_scan
from salsanext_cli.records import Scan
from salsanext_cli.storage.point_files import write_bin, write_labels

COORDINATES = st.floats(width=32, allow_nan=True, allow_infinity=True)
INTENSITIES = st.floats(0, 255, width=32)
SCANS = st.integers(0, 40).flatmap(
    lambda count: st.builds(
        Scan,
        hnp.arrays(np.float32, (count, 3), elements=COORDINATES),
        hnp.arrays(np.float32, count, elements=INTENSITIES),
    )
)


def five_columns(count, seed=0):
    random = np.random.default_rng(seed)
    columns = [random.normal(0, 20, (count, 3)), random.integers(0, 256, (count, 1))]
    return np.hstack([*columns, random.integers(0, 32, (count, 1))]).astype("<f4")


@given(SCANS)
@settings(max_examples=50, deadline=None)
def test_scan_survives_the_round_trip(tmp_path_factory, scan):
    path = tmp_path_factory.mktemp("bin") / "s.bin"
    write_bin(path, scan)
    back = kitti.read_bin(path)
    np.testing.assert_array_equal(back.points, scan.points)
    np.testing.assert_array_equal(back.intensity, scan.intensity)
    assert path.stat().st_size == 16 * len(scan)


def test_bytes_are_little_endian_x_y_z_intensity(tmp_path):
    path = tmp_path / "s.bin"
    path.write_bytes(struct.pack("<8f", 1, -2, 3, 0.5, 4, 5, -6, 0.25))
    scan = kitti.read_bin(path)
    assert scan.points.tolist() == [[1, -2, 3], [4, 5, -6]]
    assert scan.intensity.tolist() == [0.5, 0.25]
    assert kitti.encode_bin(scan) == path.read_bytes()


@pytest.mark.parametrize("size", [1, 15, 17, 16 * 9 + 8])
def test_truncated_scan_is_named_with_its_size(tmp_path, size):
    path = tmp_path / "s.bin"
    path.write_bytes(bytes(size))
    with pytest.raises(FormatError, match=f"{size} bytes") as caught:
        kitti.read_bin(path)
    assert caught.value.subject == str(path)
    assert "multiple of 16" in caught.value.expected


def test_five_columns_by_suffix(tmp_path):
    table = five_columns(30)
    path = tmp_path / "s.PCD.bin"
    path.write_bytes(table.tobytes())
    scan = read_scan(path, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, table[:, :3])
    np.testing.assert_array_equal(scan.intensity, table[:, 3] / np.float32(255))


@pytest.mark.parametrize("count", [40, 41, 42, 43])
def test_five_columns_are_not_read_as_four(tmp_path, count):
    path = tmp_path / "s.bin"
    path.write_bytes(five_columns(count, seed=count).tobytes())
    with pytest.raises(FormatError, match=r"suffix \.pcd\.bin"):
        kitti.read_bin(path)


@pytest.mark.parametrize("count", [40, 41])
def test_four_columns_are_not_read_as_five(tmp_path, count):
    path = tmp_path / "s.pcd.bin"
    path.write_bytes(five_columns(count, seed=count)[:, :4].tobytes())
    with pytest.raises(FormatError, match=r"suffix \.bin"):
        kitti.read_bin(path)


def test_negative_intensity_alone_is_no_reason_to_refuse(tmp_path):
    table = np.random.default_rng(0).normal(0, 20, (60, 4)).astype("<f4")
    (tmp_path / "s.bin").write_bytes(table.tobytes())
    assert len(kitti.read_bin(tmp_path / "s.bin")) == 60


def test_signalling_nan_is_only_a_nan(tmp_path):
    (tmp_path / "s.bin").write_bytes(struct.pack("<3f", 1, 2, 3) + b"\x01\x00\xa0\x7f")
    scan = kitti.read_bin(tmp_path / "s.bin", intensity_scale=255)
    assert np.isnan(scan.intensity).tolist() == [True]


@given(hnp.arrays(np.uint32, st.integers(0, 50)))
@settings(max_examples=30, deadline=None)
def test_labels_survive_the_round_trip(tmp_path_factory, raw):
    path = tmp_path_factory.mktemp("label") / "s.label"
    write_labels(path, raw)
    assert path.read_bytes() == b"".join(struct.pack("<I", value) for value in raw.tolist())
    np.testing.assert_array_equal(kitti.read_labels(path, len(raw)), raw)


@pytest.mark.parametrize("count", [0, 2, 4])
def test_label_count_must_be_the_point_count(tmp_path, count):
    write_labels(tmp_path / "s.label", np.zeros(3, np.uint32))
    with pytest.raises(LabelError, match=f"3 labels · expected {count}"):
        kitti.read_labels(tmp_path / "s.label", count)


def test_truncated_labels(tmp_path):
    (tmp_path / "s.label").write_bytes(bytes(7))
    with pytest.raises(FormatError, match="7 bytes"):
        kitti.read_labels(tmp_path / "s.label")


@pytest.mark.real
def test_no_real_scan_is_refused(real_data, tmp_path):
    for path in sorted((real_data / "data").rglob("*.bin")):
        columns = 5 if "five" in path.name else 4
        link = tmp_path / f"{len(list(tmp_path.iterdir()))}{'.pcd' * (columns == 5)}.bin"
        link.symlink_to(path)
        scan = kitti.read_bin(link)
        assert len(scan) == path.stat().st_size // (4 * columns)
        labels = path.parent.parent / "labels" / f"{path.stem}.label"
        if labels.exists() and "four" not in str(path):
            kitti.read_labels(labels, len(scan))


@pytest.mark.real
@pytest.mark.parametrize(
    "name", ["five_columns_hdl64s3.bin", "nuscenes_hdl32/five_columns.pcd.bin"]
)
def test_real_five_columns_are_recognised(real_data, tmp_path, name):
    (tmp_path / "s.bin").symlink_to(real_data / "data" / "sensors" / name)
    with pytest.raises(FormatError, match="5 columns"):
        kitti.read_bin(tmp_path / "s.bin")
