# SPDX-License-Identifier: MIT
"""Files with some of their points, byte for byte."""

import io
import re
from pathlib import Path

import numpy as np
import plyfile
import pytest
from scans import make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.io.formats import SCAN_SUFFIXES, format_of, scan_suffix
from salsanext_cli.io.formats.subsets import subsets_of

SCAN = make_scan(60)
KEEP = np.random.default_rng(0).random(60) < 0.5
TABLE = np.column_stack([SCAN.points, SCAN.intensity])
TIMES = np.arange(60, dtype=np.uint64)
RECORDS = np.rec.fromarrays([*TABLE.T, TIMES], names="x,y,z,intensity,t")
LINES = [" ".join(map(repr, row)) + " 7\n" for row in TABLE.astype(float).tolist()]
PCD = (
    "# .PCD\nVERSION 0.7\nFIELDS x y z intensity t\nSIZE 4 4 4 4 8\nTYPE F F F F U\n"
    "COUNT 1 1 1 1 1\n"
    "WIDTH {0}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {0}\nDATA "
)
PLY = (
    "ply\nformat {1} 1.0\ncomment of 60 things\nelement vertex {0}\n"
    + "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    + "property {2} t\nend_header\n"
)


def packed(keep, kind="<u8"):
    types = [(name, "<f4") for name in ("x", "y", "z", "intensity")] + [("t", kind)]
    return RECORDS[keep].astype(types).tobytes()


def text(keep):
    return "".join(line for line, stays in zip(LINES, keep, strict=True) if stays).encode()


def saved(save, *arrays, **named):
    with io.BytesIO() as buffer:
        save(buffer, *arrays, **named)
        return buffer.getvalue()


def feather(keep):
    """Return a Feather file with metadata, as Argoverse 2 and pandas write them."""
    pyarrow = pytest.importorskip("pyarrow")
    write = pytest.importorskip("pyarrow.feather").write_feather
    columns = {name: RECORDS[name][keep] for name in RECORDS.dtype.names}
    columns["note"] = np.array([f"no. {number}" for number in TIMES])[keep]
    table = pyarrow.table(columns).replace_schema_metadata({"pandas": "of an index"})
    return saved(lambda buffer: write(table, buffer))


MADE = {
    "a.bin": lambda keep: TABLE[keep].tobytes(),
    "a.pcd.bin": lambda keep: np.column_stack([TABLE, TABLE[:, 0]])[keep].tobytes(),
    "ascii.pcd": lambda keep: PCD.format(keep.sum()).encode() + b"ascii\n" + text(keep),
    "lower.pcd": lambda keep: PCD.lower().format(keep.sum()).encode() + b"ascii\n" + text(keep),
    "binary.pcd": lambda keep: PCD.format(keep.sum()).encode() + b"binary\n" + packed(keep),
    "ascii.ply": lambda keep: PLY.format(keep.sum(), "ascii", "int").encode() + text(keep),
    "binary.ply": lambda keep: (
        PLY.format(keep.sum(), "binary_little_endian", "int").encode() + packed(keep, "<i4")
    ),
    "a.xyz": text,
    "a.asc": text,
    "a.pts": lambda keep: f"{keep.sum()}\n".encode() + text(keep),
    "a.txt": lambda keep: f"# 3 columns\n{keep.sum()}\n".encode() + text(keep),
    "a.csv": lambda keep: b"\xef\xbb\xbfx,y,z,note,t\r\n" + text(keep).replace(b" ", b","),
    "float64.bin": lambda keep: TABLE[keep].astype("<f8").tobytes(),
    "planar.bin": lambda keep: TABLE[keep].T.tobytes(),
    "a.npy": lambda keep: saved(np.save, RECORDS[keep]),
    "a.feather": feather,
    "a.npz": lambda keep: saved(
        np.savez_compressed, points=TABLE[keep], t=TIMES[keep], pose=np.eye(4)
    ),
}


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("keep", [KEEP, ~KEEP, KEEP | True, KEEP & False])
def test_they_are_as_if_written_without_the_others(tmp_path, name, keep):
    path = tmp_path / name
    path.write_bytes(MADE[name](KEEP | True))
    assert subsets_of(path)(keep) == MADE[name](keep)
    with pytest.raises(LabelError, match="expected 59"):
        subsets_of(path)(keep[1:])


def test_most_formats_can_be_written():
    others = {suffix for suffix in SCAN_SUFFIXES if not format_of(suffix).subset}
    assert others == {".parquet"}
    assert {scan_suffix(name) for name in MADE} | others == {*SCAN_SUFFIXES} - {".las", ".laz"}
    error = refused(FormatError, "s.parquet", subsets_of, Path("s.parquet"))
    assert "write the scans as" in error.value.hint


def test_the_page_states_for_each_format_what_filter_writes():
    page = (Path(__file__).parents[3] / "docs/how-to/fuse.md").read_text("utf-8")
    table = page.partition("| what changes in the header |")[2].partition("\n\n")[0]
    refused_suffixes: set[str] = set()
    written_suffixes: set[str] = set()
    for row in table.splitlines()[2:]:
        _, names, change, _ = row.split("|")
        suffixes = refused_suffixes if change.strip().startswith("refused") else written_suffixes
        suffixes.update(re.findall(r"`(.+?)`", names))
    writable = {suffix for suffix in SCAN_SUFFIXES if format_of(suffix).subset}
    assert written_suffixes == writable
    assert refused_suffixes == {*SCAN_SUFFIXES} - writable


def test_other_elements_and_missing_points_are_refused(tmp_path):
    faces = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    vertices = RECORDS.astype([(n, "f4") for n in RECORDS.dtype.names])
    elements = [("vertex", vertices), ("face", faces)]
    mesh = plyfile.PlyData([plyfile.PlyElement.describe(of, name) for name, of in elements])
    mesh.write(str(tmp_path / "mesh.ply"))
    with pytest.raises(FormatError, match="face"):
        subsets_of(tmp_path / "mesh.ply")(KEEP)
    (tmp_path / "cut.pcd").write_bytes(MADE["binary.pcd"](KEEP | True)[:-1])
    with pytest.raises(LabelError, match="59 points"):
        subsets_of(tmp_path / "cut.pcd")(KEEP)


def test_an_organised_cloud_with_lower_case_keywords_becomes_one_row(tmp_path):
    head = PCD.lower().format(60).replace("width 60\nheight 1", "width 30\nheight 2")
    path, target = tmp_path / "organised.pcd", tmp_path / "kept.pcd"
    path.write_bytes(head.encode() + b"binary\n" + packed(KEEP | True))
    target.write_bytes(subsets_of(path)(KEEP))
    assert f"width {KEEP.sum()}\nheight 1\n".encode() in target.read_bytes()
    np.testing.assert_array_equal(read_scan(target).points, SCAN.points[KEEP])


def test_real_files(real_data, tmp_path):
    """Compressed and organised clouds, padding, bytes: points read are those kept."""
    for path in sorted((real_data / "data/sensors/pcd").iterdir()):
        scan = read_scan(path)
        keep = np.random.default_rng(0).random(len(scan)) < 0.4
        (tmp_path / path.name).write_bytes(subsets_of(path)(keep))
        found, expected = read_scan(tmp_path / path.name), scan.take(np.flatnonzero(keep))
        assert found.points.tobytes() == expected.points.tobytes(), path.name
        assert found.intensity.tobytes() == expected.intensity.tobytes()
