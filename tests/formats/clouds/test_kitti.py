# SPDX-License-Identifier: MIT
import gzip
import re
import struct

import numpy as np
import pytest

from salsanext_cli import read_scan
from salsanext_cli.errors import FormatError
from salsanext_cli.formats import kitti
from salsanext_cli.formats.kitti import evident_count, read_labels
from salsanext_cli.results.layout import find_scans


def five_columns(count, seed=0):
    random = np.random.default_rng(seed)
    columns = [random.normal(0, 20, (count, 3)), random.integers(0, 256, (count, 1))]
    return np.hstack([*columns, random.integers(0, 32, (count, 1))]).astype("<f4")


def test_bytes_are_little_endian_x_y_z_intensity(tmp_path):
    path = tmp_path / "s.bin"
    path.write_bytes(struct.pack("<8f", 1, -2, 3, 0.5, 4, 5, -6, 0.25))
    scan = kitti.read_bin(path)
    assert scan.points.tolist() == [[1, -2, 3], [4, 5, -6]]
    assert scan.intensity.tolist() == [0.5, 0.25]
    assert kitti.encode_bin(scan) == path.read_bytes()


@pytest.mark.parametrize("name", ["s.bin.gz", "S.BIN.GZ", "s.pcd.bin.gz"])
def test_compressed_files_are_read_as_the_others(tmp_path, name):
    width = 5 if "pcd" in name else 4
    table = np.random.default_rng(0).uniform(1, 9, (300, width)).astype("<f4")
    (tmp_path / name).write_bytes(gzip.compress(table.tobytes()))
    scan = read_scan(tmp_path / name)
    np.testing.assert_array_equal(scan.points, table[:, :3])
    np.testing.assert_array_equal(scan.intensity, table[:, 3])
    assert (scan.ring is None) == (width == 4)
    assert [file.stem for file in find_scans(tmp_path)] == ["S" if name[0] == "S" else "s"]


def test_compressed_files_that_are_damaged_or_too_large(tmp_path, monkeypatch):
    path, whole = tmp_path / "s.bin.gz", gzip.compress(bytes(1 << 16))
    monkeypatch.setattr(kitti, "MAX_DECOMPRESSED_BYTES", 1 << 15)
    for content, message in {
        b"": "is empty",
        gzip.compress(bytes(1 << 9))[:-9]: "damaged or cut off",
        b"plain" * 9: "damaged or cut off",
        gzip.compress(b""): "is empty",
        whole: "more than 0 MiB when decompressed",
    }.items():
        path.write_bytes(content)
        with pytest.raises(FormatError, match=message):
            read_scan(path)


@pytest.mark.parametrize("size", [1, 15, 17, 16 * 9 + 8])
def test_truncated_scan_is_named_with_its_size(tmp_path, size):
    path = tmp_path / "s.bin"
    path.write_bytes(bytes(size))
    with pytest.raises(FormatError, match=f"{size} bytes") as caught:
        kitti.read_bin(path)
    assert caught.value.subject == str(path)
    assert "multiple of 16" in caught.value.expected


@pytest.mark.parametrize("count", [40, 41, 42, 43])
@pytest.mark.parametrize(("columns", "suffix"), [(5, ".bin"), (4, ".pcd.bin")])
def test_another_number_of_columns_is_recognised(tmp_path, count, columns, suffix):
    path = tmp_path / f"s{suffix}"
    path.write_bytes(five_columns(count, seed=count)[:, :columns].tobytes())
    with pytest.raises(FormatError, match=rf"suffix {'.pcd.bin' if columns == 5 else '.bin'}"):
        kitti.read_bin(path)


def test_negative_intensities_and_signalling_nans_are_read(tmp_path):
    table = np.random.default_rng(0).normal(0, 20, (59, 4)).astype("<f4")
    nan = struct.pack("<3f", 1, 2, 3) + b"\x01\x00\xa0\x7f"
    (tmp_path / "s.bin").write_bytes(table.tobytes() + nan)
    scan = kitti.read_bin(tmp_path / "s.bin", intensity_scale=255)
    assert np.flatnonzero(np.isnan(scan.intensity)).tolist() == [59]


@pytest.mark.real
def test_no_real_scan_is_refused(real_data, tmp_path):
    for path in sorted((real_data / "data").rglob("*.bin")):
        columns = 5 if "five" in path.name else 4
        link = tmp_path / f"{len(list(tmp_path.iterdir()))}{'.pcd' * (columns == 5)}.bin"
        link.symlink_to(path)
        scan = kitti.read_bin(link)
        assert len(scan) == path.stat().st_size // (4 * columns)
        labels = path.parent.parent / "labels" / f"{path.stem}.label"
        if labels.exists():
            raw = read_labels(labels, len(scan))
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
        with pytest.raises(FormatError, match=r"holds \d+ columns · expected 4") as caught:
            kitti.read_bin(path)
        (names,) = re.findall(r"--columns (\S+)", str(caught.value))
        scan = kitti.read_bin(path, columns=tuple(names.split(",")))
        np.testing.assert_array_equal(scan.points, table[:, :3])


@pytest.mark.real
def test_no_real_scan_in_another_order_is_refused(real_data):
    for path in sorted((real_data / "data").rglob("*.bin"))[::4]:
        count = 5 if "five" in path.name else 4
        table = np.fromfile(path, "<f4").reshape(-1, count)
        shuffled = np.random.default_rng(0).permutation(table)
        for rows in (table, shuffled, table[: len(table) // 2], shuffled[:100]):
            assert evident_count(rows.ravel(), count) is None, path
            assert evident_count(rows.ravel(), 9 - count) in {count, None}, path
        assert evident_count(shuffled.ravel(), 9 - count) == count, path
