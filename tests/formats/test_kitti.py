# SPDX-License-Identifier: MIT
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from salsanext_cli.errors import FormatError, LabelError
from salsanext_cli.formats import kitti, read_scan
from salsanext_cli.records import Scan

COORDINATES = st.floats(width=32, allow_nan=True, allow_infinity=True)
INTENSITIES = st.floats(0, 255, width=32)


@st.composite
def scans(draw: st.DrawFn) -> Scan:
    count = draw(st.integers(0, 40))
    return Scan(
        draw(hnp.arrays(np.float32, (count, 3), elements=COORDINATES)),
        draw(hnp.arrays(np.float32, count, elements=INTENSITIES)),
    )


def five_columns(count: int, rng: np.random.Generator) -> np.ndarray:
    columns = [rng.normal(0, 20, (count, 3)), rng.integers(0, 256, (count, 1))]
    return np.hstack([*columns, rng.integers(0, 32, (count, 1))]).astype("<f4")


@given(scans())
@settings(max_examples=50, deadline=None)
def test_scan_survives_the_round_trip(tmp_path_factory: pytest.TempPathFactory, scan: Scan) -> None:
    path = tmp_path_factory.mktemp("bin") / "s.bin"
    kitti.write_bin(path, scan)
    back = kitti.read_bin(path)
    np.testing.assert_array_equal(back.points, scan.points)
    np.testing.assert_array_equal(back.intensity, scan.intensity)
    assert path.stat().st_size == 16 * len(scan)


def test_bytes_are_little_endian_x_y_z_intensity(tmp_path: Path) -> None:
    path = tmp_path / "s.bin"
    path.write_bytes(struct.pack("<8f", 1, -2, 3, 0.5, 4, 5, -6, 0.25))
    scan = kitti.read_bin(path)
    assert scan.points.tolist() == [[1, -2, 3], [4, 5, -6]]
    assert scan.intensity.tolist() == [0.5, 0.25]
    kitti.write_bin(tmp_path / "again.bin", scan)
    assert (tmp_path / "again.bin").read_bytes() == path.read_bytes()


def test_arrays_can_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "s.bin").write_bytes(bytes(32))
    scan = kitti.read_bin(tmp_path / "s.bin")
    scan.points[0] = 1
    scan.intensity[0] = 1
    assert scan.points.flags.c_contiguous


@pytest.mark.parametrize("count", [0, 1])
def test_smallest_scans(tmp_path: Path, count: int) -> None:
    (tmp_path / "s.bin").write_bytes(bytes(16 * count))
    (tmp_path / "s.label").write_bytes(bytes(4 * count))
    assert len(kitti.read_bin(tmp_path / "s.bin")) == count
    assert kitti.read_labels(tmp_path / "s.label", count).shape == (count,)


@pytest.mark.parametrize("size", [1, 15, 17, 16 * 9 + 8])
def test_truncated_scan_is_named_with_its_size(tmp_path: Path, size: int) -> None:
    path = tmp_path / "s.bin"
    path.write_bytes(bytes(size))
    with pytest.raises(FormatError, match=f"{size} bytes") as caught:
        kitti.read_bin(path)
    assert caught.value.subject == str(path)
    assert "multiple of 16" in caught.value.expected


def test_five_columns_by_suffix(tmp_path: Path) -> None:
    table = five_columns(30, np.random.default_rng(0))
    path = tmp_path / "s.PCD.bin"
    path.write_bytes(table.tobytes())
    scan = read_scan(path, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, table[:, :3])
    np.testing.assert_array_equal(scan.intensity, table[:, 3] / np.float32(255))


@pytest.mark.parametrize("count", [40, 41, 42, 43])
def test_five_columns_are_not_taken_for_four(tmp_path: Path, count: int) -> None:
    path = tmp_path / "s.bin"
    path.write_bytes(five_columns(count, np.random.default_rng(count)).tobytes())
    with pytest.raises(FormatError, match=r"suffix \.pcd\.bin"):
        kitti.read_bin(path)
    assert len(kitti.read_bin(path, columns=5)) == count


@pytest.mark.parametrize("count", [40, 41])
def test_four_columns_are_not_taken_for_five(tmp_path: Path, count: int) -> None:
    path = tmp_path / "s.pcd.bin"
    path.write_bytes(five_columns(count, np.random.default_rng(count))[:, :4].tobytes())
    with pytest.raises(FormatError, match=r"suffix \.bin"):
        kitti.read_bin(path)


def test_negative_intensity_alone_is_no_reason_to_refuse(tmp_path: Path) -> None:
    table = np.random.default_rng(0).normal(0, 20, (60, 4)).astype("<f4")
    (tmp_path / "s.bin").write_bytes(table.tobytes())
    assert len(kitti.read_bin(tmp_path / "s.bin")) == 60


def test_signalling_nan_is_only_a_nan(tmp_path: Path) -> None:
    (tmp_path / "s.bin").write_bytes(struct.pack("<3f", 1, 2, 3) + b"\x01\x00\xa0\x7f")
    scan = kitti.read_bin(tmp_path / "s.bin", intensity_scale=255)
    assert np.isnan(scan.intensity).tolist() == [True]


@given(hnp.arrays(np.uint32, st.integers(0, 50)))
@settings(max_examples=30, deadline=None)
def test_labels_survive_the_round_trip(
    tmp_path_factory: pytest.TempPathFactory, raw: np.ndarray
) -> None:
    path = tmp_path_factory.mktemp("label") / "s.label"
    kitti.write_labels(path, raw)
    assert path.read_bytes() == b"".join(struct.pack("<I", value) for value in raw.tolist())
    np.testing.assert_array_equal(kitti.read_labels(path, len(raw)), raw)


def test_instance_bits_are_kept(tmp_path: Path) -> None:
    (tmp_path / "s.label").write_bytes(struct.pack("<HH", 10, 7))
    assert kitti.read_labels(tmp_path / "s.label").tolist() == [10 + (7 << 16)]


@pytest.mark.parametrize("count", [0, 2, 4])
def test_label_count_must_be_the_point_count(tmp_path: Path, count: int) -> None:
    kitti.write_labels(tmp_path / "s.label", np.zeros(3, np.uint32))
    with pytest.raises(LabelError, match=f"3 labels · expected {count}"):
        kitti.read_labels(tmp_path / "s.label", count)


def test_truncated_labels(tmp_path: Path) -> None:
    (tmp_path / "s.label").write_bytes(bytes(7))
    with pytest.raises(FormatError, match="7 bytes"):
        kitti.read_labels(tmp_path / "s.label")


def test_missing_file_and_folder_in_its_place(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no such file"):
        kitti.read_bin(tmp_path / "s.bin")
    with pytest.raises(FormatError, match="no such file"):
        kitti.read_labels(tmp_path / "s.label")
    (tmp_path / "s.bin").mkdir()
    with pytest.raises(FormatError, match="is a directory"):
        kitti.read_bin(tmp_path / "s.bin")


@pytest.mark.real
def test_no_real_scan_is_refused(real_data: Path) -> None:
    for path in sorted((real_data / "data").rglob("*.bin")):
        columns = 5 if "five" in path.name else 4
        scan = kitti.read_bin(path, columns)
        assert len(scan) == path.stat().st_size // (4 * columns)
        labels = path.parent.parent / "labels" / f"{path.stem}.label"
        if labels.exists() and "four" not in str(path):
            kitti.read_labels(labels, len(scan))


@pytest.mark.real
def test_real_five_columns_are_recognised(real_data: Path, tmp_path: Path) -> None:
    sensors = real_data / "data" / "sensors"
    for path in (
        sensors / "five_columns_hdl64s3.bin",
        sensors / "nuscenes_hdl32" / "five_columns.pcd.bin",
    ):
        with pytest.raises(FormatError, match="5 columns"):
            kitti.read_bin(path, columns=4)
    assert len(read_scan(sensors / "nuscenes_hdl32" / "five_columns.pcd.bin")) == 34688
