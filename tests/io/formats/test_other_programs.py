# SPDX-License-Identifier: MIT
"""Layouts of other programs are read with a notice; other files are refused by name."""

import io
import logging
import struct
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan

from salsanext_cli import read_scan
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.formats.kitti import read_bin
from salsanext_cli.io.formats.npy import read_integers
from salsanext_cli.io.formats.pcd import pcd_columns
from salsanext_cli.io.formats.subsets import subsets_of

SCAN = make_scan(300)
TABLE = np.column_stack([SCAN.points, SCAN.intensity])
X, Y, Z, I = TABLE.T  # noqa: E741 - the name of the column
PCD = (
    "# .PCD v.7\nVERSION .7\nFIELDS x y z intensity t\nSIZE 4 4 4 4 8\nTYPE F F F F F\n"
    "COUNT 1 1 1 1 1\nWIDTH 300\nHEIGHT 1\nPOINTS 300\nDATA ascii\n"
)
LINES = [" ".join(map(repr, row)) + " 7.5\n" for row in TABLE.astype(float).tolist()]
VELOVIEW = '"intensity","laser_id","Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2"\n' + "".join(
    f"{i!r},7,{x!r},{y!r},{z!r}\n" for x, y, z, i in TABLE.astype(float).tolist()
)


def saved(save, *arrays, **named):
    with io.BytesIO() as buffer:
        save(buffer, *arrays, **named)
        return buffer.getvalue()


def pcd(old="", new="", lines=LINES):
    return (PCD.replace(old, new) + "".join(lines)).encode()


LAYOUTS = {
    "velo.csv": (VELOVIEW.encode(), "Points_m_XYZ:0"),
    "view.csv": (VELOVIEW.replace("_m_XYZ", "").encode(), "Points:0"),
    "rows.npy": (saved(np.save, TABLE.T), "transposed"),
    "rows_f8.npy": (saved(np.save, TABLE.T.astype("<f8", "C")), "transposed"),
    "rows.npz": (saved(np.savez, TABLE.T), "transposed"),
    "arrays.npz": (saved(np.savez, X, Y, Z, I), "without names are read as x, y, z, intensity"),
    "beside.npz": (saved(np.savez, TABLE[:, :3], I), "is read as intensity"),
    "more.npz": (saved(np.savez, x=X, y=Y, z=Z, intensity=I, t=np.ones(9)), "skipped: t"),
    "table.npz": (saved(np.savez, points=TABLE, stamp=np.ones(1)), "skipped: stamp"),
    "kind_d.pcd": (pcd("F F F F F", "F F F F D"), "TYPE D"),
    "sizes.pcd": (pcd("4 4 4 4 8", "4, 4, 4, 4, 8"), "commas"),
    "values.pcd": (pcd(lines=[line.replace(" ", ",") for line in LINES]), "commas"),
    "less.pcd": (pcd("300", "12"), "300 lines of points, but its header states 12"),
}


@pytest.fixture
def said(caplog):
    """Return the log of a process that has not read any file."""
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    return caplog


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_are_read_with_a_notice_for_their_kind(tmp_path, said, name):
    content, notice = LAYOUTS[name]
    for path in (tmp_path / name, tmp_path / f"other_{name}"):
        path.write_bytes(content)
        scan = read_scan(path)
        np.testing.assert_array_equal(scan.points, SCAN.points)
        np.testing.assert_array_equal(scan.intensity, SCAN.intensity)
    assert notice in said.messages[0]
    # Missing points are reported for each file.
    warnings = [record.getMessage() for record in said.records if record.levelno == logging.WARNING]
    paths = [str(tmp_path / name), str(tmp_path / f"other_{name}")] * ("header" in notice)
    assert [message.split(": ")[0] for message in warnings] == paths
    assert len(said.messages) == max(1, len(paths))


@pytest.mark.parametrize("name", LAYOUTS)
def test_some_of_their_points_are_written_in_their_layout(tmp_path, name):
    path, kept = tmp_path / name, tmp_path / f"kept_{name}"
    path.write_bytes(LAYOUTS[name][0])
    keep = np.random.default_rng(0).random(300) < 0.5
    kept.write_bytes(subsets_of(path)(keep))
    np.testing.assert_array_equal(read_scan(kept).points, SCAN.points[keep])
    np.testing.assert_array_equal(read_scan(kept).intensity, SCAN.intensity[keep])


def test_named_columns_of_transposed_tables_arrays_and_integers(tmp_path):
    named = replace(SMALL, columns=("intensity", "x", "y", "z", "_", "_"))
    rows = np.stack([I, X, Y, Z, X, X])
    np.save(tmp_path / "s.npy", rows)
    np.savez(tmp_path / "s.npz", *rows)
    for name in ("s.npy", "s.npz"):
        np.testing.assert_array_equal(read_scan(tmp_path / name, named).points, SCAN.points)
    np.savez(tmp_path / "s.npz", X, Y, Z, np.arange(300))
    scan = read_scan(tmp_path / "s.npz", replace(SMALL, columns=("x", "y", "z", "intensity")))
    np.testing.assert_array_equal(scan.intensity, np.arange(300))


@pytest.mark.parametrize("points", [[X, Y, Z], [TABLE[:, :3]]], ids=["columns", "table"])
def test_integers_without_a_name_are_no_intensity(tmp_path, said, points):
    np.savez(tmp_path / "s.npz", *points, np.arange(300))
    scan = read_scan(tmp_path / "s.npz")
    np.testing.assert_array_equal(scan.points, SCAN.points)
    assert not scan.intensity.any()
    assert f"arr_{len(points)}" in said.text
    assert "ignored" in said.text


def test_a_short_line_lacks_only_its_last_values(tmp_path, said):
    path = tmp_path / "s.pcd"
    whole, partial = LINES[100].split(" ", 3)[:3], LINES[200].split()[:2]
    lines = [*LINES[:100], " ".join(whole) + "\n", *LINES[101:200], " ".join(partial) + "\n"]
    path.write_bytes(pcd(lines=[*lines, *LINES[201:]]))
    scan, expected = read_scan(path), SCAN.points.copy()
    expected[200, 2] = np.nan
    np.testing.assert_array_equal(scan.points, expected)
    assert np.flatnonzero(np.isnan(scan.intensity)).tolist() == [100, 200]
    # The header has ten lines.
    assert f"{path}: line 111 has 3 of 5 values" in said.text
    assert f"{path}: line 211 has 2 of 5 values" in said.text


def test_a_scan_knows_the_points_that_its_file_lacks(tmp_path, said):
    path = tmp_path / "s.pcd"
    path.write_bytes(pcd("300", "12466"))
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    assert scan.notes.missing_points == 12166
    findings = check_scan(path, scan, SMALL).findings
    assert findings[0].code == "missing-points"
    assert "12,166" in findings[0].problem
    assert not said.messages
    # Clouds with labels are not checked.
    pcd_columns(path)
    assert str(path) in said.text
    path.write_bytes(pcd())
    assert "missing-points" not in [
        f.code for f in check_scan(path, read_scan(path), SMALL).findings
    ]


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([*LINES[:-1], "1.0 2.0\n"], "299 of 300 points; line 310 has 2 of 5 values"),
        ([*LINES[:200], LINES[200][:-1]], "201 of 300 points"),
        ([*LINES, "1 2"], "300 of 300 points; line 311 has 2 of 5 values"),
        ([*LINES[:9], "1 2\n" * 4, *LINES[13:]], "4 of 300 lines .* line 20 has 2 of 5 values"),
        ([*LINES[:9], "1 2 x\n", *LINES[10:]], "line 20 has 'x'"),
        ([*LINES[:9], "\n1 2 3 4 5 6\n", *LINES[10:]], "line 21 has 6 of 5 values"),
        ([line.replace(".", ",") for line in LINES], "decimal commas: -?[0-9]+,[0-9]+"),
    ],
)
def test_ascii_points_that_are_cut_off_or_not_a_table(tmp_path, lines, problem):
    path = tmp_path / "s.pcd"
    path.write_bytes(pcd(lines=lines))
    with pytest.raises(FormatError, match=problem) as caught:
        read_scan(path)
    assert "usecols" not in str(caught.value)


@pytest.mark.parametrize("shape", [(9, 1), (1, 9)])
def test_labels_in_one_column_or_row(tmp_path, said, shape):
    np.save(tmp_path / "l.npy", np.arange(9, dtype=np.int32).reshape(shape))
    np.testing.assert_array_equal(read_integers(tmp_path / "l.npy"), np.arange(9))
    assert "(N, 1)" in said.text
    with pytest.raises(FormatError, match=rf"has {shape[1]} columns?"):
        read_scan(tmp_path / "l.npy")


def rotation(turn=0.3):
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0, 5.5], [s, c, 0, -2], [0, 0, 1, 0.25]])


MATRICES = {
    "pose": rotation(),
    "square pose": np.vstack([rotation(), [0, 0, 0, 1]]),
    "rotation": rotation()[:, :3],
    "projection": np.array([[721.5, 0, 609.6, 44.9], [0, 721.5, 172.9, 0.2], [0, 0, 1, 0.003]]),
}


@pytest.mark.parametrize("name", MATRICES)
def test_a_matrix_is_not_a_scan_of_three_points(tmp_path, name):
    matrix = MATRICES[name]
    np.savetxt(tmp_path / "m.txt", matrix)
    np.save(tmp_path / "m.npy", matrix)
    if matrix.shape[1] == 4:
        (tmp_path / "m.bin").write_bytes(matrix.astype("<f4").tobytes())
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(FormatError, match="matrix"):
            read_scan(path)
    # Three or four points are not refused for being few.
    np.savetxt(tmp_path / "p.txt", 2 * matrix)
    assert len(read_scan(tmp_path / "p.txt")) == len(matrix)


KINDS = {
    "a message of ROS 2": b"\0\1\0\0" + struct.pack("<II", 9, 77) + b"\x0b\0\0\0lidar_link\0",
    "a TerraScan file": struct.pack("<II8sI", 56, 20020715, b"\xa1\xce\x0e\0CXYZ", 1000),
    "a .feather file": b"ARROW1\0\0",
    "a .parquet file": b"PAR1\x15\0",
    "an E57 file": b"ASTM-E57\1\0\0\0",
    "a LAS file": b"LASF\0\0\1\0",
    "a .mcap file": b"\x89MCAP0\r\n",
    "a .bag file": b"#ROSBAG V2.0\n",
}


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_other_kinds_are_named(tmp_path, kind):
    path = tmp_path / "s.bin"
    path.write_bytes(KINDS[kind] + TABLE.astype("<i4").tobytes())
    with pytest.raises(FormatError) as caught:
        read_bin(path)
    assert caught.value.problem == f"is {kind}"
    assert (kind.split()[1] in caught.value.hint) == (kind[2] == ".")


def test_integers_have_no_columns_to_name(tmp_path):
    """Records of seven words, in a file of an unknown format."""
    records = np.zeros(2000, [("time", "<u4"), ("xyz", "<i4", 3), ("kind", "u1", 12)])
    records["time"], records["kind"] = np.arange(2000), 3
    records["xyz"] = np.tile(SCAN.points * 1000, (7, 1))[:2000]
    (tmp_path / "s.bin").write_bytes(records.tobytes())
    with pytest.raises(FormatError, match="not coordinates"):
        read_bin(tmp_path / "s.bin")


@pytest.mark.real
def test_reported_files_have_the_points_of_their_scan(real_data):
    folder = real_data / "data/reported"
    truth = np.load(folder / "reference_points_labels.npz")
    # Text has four decimals, "%.4f".
    for name in (
        *("csv/veloview.csv", "npy/transposed_4xN.npy", "npy/unnamed_columns.npz"),
        *("pcd/size_with_commas.pcd", "pcd/type_D_timestamp.pcd", "pcd/width_too_large.pcd"),
        "pcd/nan_and_short_row.pcd",
    ):
        scan = read_scan(folder / name)
        expected = truth["xyz"][: len(scan)]
        measured = np.isfinite(scan.points).all(axis=1)
        assert len(scan) in {20_000, 40_000}
        assert measured.sum() >= len(scan) - 2, name
        atol = 0 if name.startswith("npy/") else 6e-5
        np.testing.assert_allclose(scan.points[measured], expected[measured], rtol=0, atol=atol)
        if scan.intensity.any():
            intensity = truth["intensity"][: len(scan)]
            np.testing.assert_array_equal(scan.intensity[measured], intensity[measured])
    labels = read_integers(folder / "npy/labels_Nx1_int32.npy")
    np.testing.assert_array_equal(labels, truth["label"])


@pytest.mark.real
def test_reported_files_that_are_not_scans_are_named(real_data):
    folder = real_data / "data/reported"
    for name, problem in {
        "not_scans/dds_message.bin": "is a message of ROS 2",
        "not_scans/20020715-time-color.bin": "is a TerraScan file",
        "not_scans/no_vertex.ply": "no vertices",
        "npy/five_cols_divisible.bin": "5 columns",
        "pcd/utm17_comma.pcd": "map coordinates",
    }.items():
        with pytest.raises(FormatError) as caught:
            read_scan(folder / name)
        assert problem in caught.value.problem


def test_columns_that_a_header_overrules_are_noticed(tmp_path, said):
    path = tmp_path / "s.csv"
    path.write_text("x,y,z\n1,2,3\n")
    assert read_scan(path, replace(SMALL, columns=("z", "y", "x"))).points.tolist() == [[1, 2, 3]]
    assert "columns is ignored" in said.text
