# SPDX-License-Identifier: MIT
"""Tables of text as many programs write them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, named_by_hint, refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.formats.subsets import subsets_of

ROWS = [[1.5, -2.0, 3e-3, 0.25], [4.0, 5.0, -6.0, 1.0]]
TABLES = {
    "plain": "1.5 -2 3e-3 .25\n4 5 -6 1\n",
    "commas and blanks": "1.5, -2, 3e-3, .25\n4, 5, -6, 1\n\n",
    "semicolons": "1.5;-2;3e-3;.25\n4;5;-6;1\n",
    "a fifth column": "1.5 -2 3e-3 .25 7\n4 5 -6 1 8\n",
    "header": "X,Y,Z,Intensity\n1.5,-2,3e-3,.25\n4,5,-6,1\n",
    "other order": "ring;intensity;z;y;x\n9;.25;3e-3;-2;1.5\n9;1;-6;5;4\n",
    "quotes and text": '"Name","X","Y","Z","remission"\n"a b",1.5,-2,3e-3,.25\n"c",4,5,-6,1\n',
    "comment": "//X Y Z Scalar_Intensity R G B\n1.5 -2 3e-3 .25 1 2 3\n4 5 -6 1 4 5 6\n",
    "comments": "# x y z in metres, of a test\n#\n\n1.5 -2 3e-3 .25\n4 5 -6 1\n",
    "number of points and a comment": "2\nframe 7 of a test\n1.5 -2 3e-3 .25\n4 5 -6 1\n",
    "number of points and names": "//X Y Z I\n2\n1.5 -2 3e-3 .25\n4 5 -6 1\n",
    "mark of the order of bytes": "\ufeffx y z i\n1.5 -2 3e-3 .25\n4 5 -6 1\n",
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_several_programs(tmp_path, name):
    for suffix in (".csv", ".asc", ".txt", ".pts"):
        path = tmp_path / f"s{suffix}"
        path.write_text(TABLES[name], "utf-8")
        scan = read_scan(path)
        np.testing.assert_array_equal(scan.points, np.float32(ROWS)[:, :3])
        np.testing.assert_array_equal(scan.intensity, np.float32(ROWS)[:, 3])


HEADERS = {
    "Ouster": (
        "# TIMESTAMP (ns), ROW, RANGE (mm), REFLECTIVITY (%), X1 (mm), Y1 (mm), Z1 (mm)\n"
        "17, 0, 2500, 0.25, 1500, -2000, 3\n18, 1, 8775, 1, 4000, 5000, -6000\n"
    ),
    "units": "X [m],Y [m],Z [m],Intensity [-]\n1.5,-2,3e-3,.25\n4,5,-6,1\n",
    "units and blanks": "# x (cm) y (cm) z (cm) remission\n150 -200 .3 .25\n400 500 -600 1\n",
    "units behind an underscore": "x_mm;y_mm;z_mm;i\n1500;-2000;3;.25\n4000;5000;-6000;1\n",
    "another prefix": "pos_x,pos_y,pos_z,laser.Reflectivity\n1.5,-2,3e-3,.25\n4,5,-6,1\n",
    "scalars": "//X Y Z Scalar_Reflectance\n1.5 -2 3e-3 .25\n4 5 -6 1\n",
    "both axes": "x1,y1,z1,x,y,z,i\n0,0,0,1.5,-2,3e-3,.25\n0,0,0,4,5,-6,1\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_names_with_units_prefixes_and_synonyms(tmp_path, name):
    for suffix in (".csv", ".xyz"):
        path = tmp_path / f"s{suffix}"
        path.write_text(HEADERS[name], "utf-8")
        scan = read_scan(path)
        np.testing.assert_allclose(scan.points, np.float32(ROWS)[:, :3], rtol=1e-6)
        np.testing.assert_array_equal(scan.intensity, np.float32(ROWS)[:, 3])


def test_other_units_than_metres_are_noticed(tmp_path, caplog):
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    (tmp_path / "s.csv").write_text(HEADERS["Ouster"])
    read_scan(tmp_path / "s.csv")
    assert "X1 (mm), Y1 (mm), Z1 (mm)" in caplog.text
    assert "in mm are converted to metres" in caplog.text


CELLS = {
    "pandas": ",x,y,z,intensity\n0,1.5,-2,3e-3,.25\n1,,,,\n2,4,5,-6,1\n",
    "semicolons": "1.5;-2;3e-3;.25\n ; ; ;\n4;5;-6;1\n",
    "words": "x,y,z,i\r\n1.5,-2,3e-3,.25\r\nNA,null,None,N/A\r\n4,5,-6,1\r\n",
    "blanks": "x y z i\n1.5 -2 3e-3 .25\nNA NaN null NA\n4 5 -6 1\n",
    "tabs": "x\ty\tz\ti\n1.5\t-2\t3e-3\t.25\n\t\t\t\n4\t5\t-6\t1\n",
    "tabs and words": "1.5\t-2\t3e-3\t.25\r\n\tNA\t\t\r\n4\t5\t-6\t1\r\n",
    "quotes": '"x","y","z","i"\n"1.5","-2","3e-3",".25"\n"","","",""\n4,5,-6,1\n\n',
}


@pytest.mark.parametrize("name", CELLS)
def test_an_empty_cell_is_a_point_without_a_measurement(tmp_path, name):
    path = tmp_path / "s.csv"
    path.write_text(CELLS[name], newline="")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points[::2], np.float32(ROWS)[:, :3])
    np.testing.assert_array_equal(scan.intensity[::2], np.float32(ROWS)[:, 3])
    assert len(scan) == 3
    assert np.isnan([*scan.points[1], scan.intensity[1]]).all()


def test_a_first_row_without_a_measurement_is_no_header(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(",,,\n1,2,3,4\n")
    for sensor in (SMALL, replace(SMALL, columns=("x", "y", "z", "intensity"))):
        assert len(read_scan(path, sensor)) == 2


LEICA = np.array([[1, -2, 3, -119, 10, 20, 30], [4, 5, -6, 96, 0, 255, 128]])


@pytest.mark.parametrize("separator", ["\t", " \t", "\t\t"])
def test_tabs_beside_blanks_align_values(tmp_path, separator):
    path = tmp_path / "s.txt"
    path.write_text("".join("\t" + separator.join(map(str, row)) + "\t\n" for row in ROWS))
    np.testing.assert_array_equal(read_scan(path).points, np.float32(ROWS)[:, :3])


@pytest.mark.parametrize("mark", ["#", "//", "%"])
@pytest.mark.parametrize("delimiter", [" ", ",", "\t"])
def test_comments_between_points_are_skipped_and_filtered(tmp_path, mark, delimiter):
    path, kept = tmp_path / "s.csv", tmp_path / "kept.csv"
    lines = [delimiter.join(map(str, row)) for row in ROWS]
    path.write_text("\n".join(["x y z i".replace(" ", delimiter), f"{mark} of, a test", lines[0]]))
    with path.open("a") as file:
        file.write(f"\n  {mark} turn 2\n{lines[1]}\n{mark} end")
    np.testing.assert_array_equal(read_scan(path).points, np.float32(ROWS)[:, :3])
    kept.write_bytes(subsets_of(path)(np.array([False, True])))
    np.testing.assert_array_equal(read_scan(kept).points, np.float32(ROWS)[1:, :3])


@pytest.mark.parametrize("least", [-119, -2048, 0])
def test_points_of_leica(tmp_path, least):
    """The seven columns are fixed, and equal intensities of several files stay equal."""
    path, rows = tmp_path / "s.pts", LEICA.copy()
    rows[0, 3] = least
    text = "2\n" + "".join(" ".join(map(str, row)) + "\n" for row in rows.tolist())
    path.write_text(text)
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, rows[:, :3])
    np.testing.assert_array_equal(scan.intensity, rows[:, 3])
    path.write_text("2\n" + "".join(f"{x} {y} {z} 9 8 7\n" for x, y, z, *_ in rows.tolist()))
    np.testing.assert_array_equal(read_scan(path).points, rows[:, :3])
    assert not read_scan(path).intensity.any()
    # In other files the columns vary.
    (tmp_path / "s.txt").write_text(text)
    assert len(named_by_hint(tmp_path / "s.txt")) == 7


@pytest.mark.parametrize("head", ["", "lon,lat,alt,i,a,b\n", "# six columns\n"])
def test_the_hint_has_as_many_names_as_columns(tmp_path, head):
    path = tmp_path / "s.csv"
    path.write_text(f"{head}1,2,3,4,5,6\n7,8,9,10,11,12\n")
    scan = read_scan(path, replace(SMALL, columns=named_by_hint(path)))
    assert scan.points.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert scan.intensity.tolist() == [4, 10]


NUMBERS = st.floats(-500, 500, width=32) | st.sampled_from([0.0, -0.0, float("nan"), 1e-30])


@given(st.lists(st.tuples(*[NUMBERS] * 4), min_size=1, max_size=20), st.sampled_from(" ,;\t"))
def test_text_of_python_is_read_exactly(tmp_path_factory, rows, mark):
    path = tmp_path_factory.mktemp("text") / "s.xyz"
    path.write_text("".join(mark.join(map(repr, row)) + "\n" for row in rows))
    scan = read_scan(path, replace(SMALL, intensity_scale=2.0))
    np.testing.assert_array_equal(scan.points, np.float32(rows)[:, :3])
    np.testing.assert_array_equal(scan.intensity, np.float32(rows)[:, 3] / np.float32(2))


def test_columns_name_those_of_files_without_a_header(tmp_path):
    path = tmp_path / "s.txt"
    named = replace(SMALL, columns=("_", "z", "y", "x", "ring", "reflectivity", "_"))
    for header in ("", "a,b,c,d,e,f,g\n"):
        path.write_text(f"{header}0,3,2,1,9,.5,0\n0,6,5,4,9,1,0\n")
        scan = read_scan(path, named)
        assert scan.points.tolist() == [[1, 2, 3], [4, 5, 6]]
        assert scan.intensity.tolist() == [0.5, 1]
    path.write_text("i,x,y,z\n.5,1,2,3\n")
    assert read_scan(path, named).points.tolist() == [[1, 2, 3]]
    path.write_text("1 2 3\n")
    assert read_scan(path).intensity.tolist() == [0]
    path.write_text("x,y,z\n")
    assert len(read_scan(path)) == 0
    path.write_text("1 2 3 4\n")
    with pytest.raises(FormatError, match="expected 3: x, y, z"):
        read_scan(path, replace(SMALL, columns=("x", "y", "z")))


def test_other_text_is_refused(tmp_path):
    for text, problem in (
        ("", "no points"),
        ("1 2\n", "2 columns"),
        ("3\n1 2 3 4\n5 6 7 8\n", "2 of the 3 points"),
        ("9" * 5000 + "\n1 2 3 4\n", "Exceeds the limit"),
        ("1 2 3 255 0 0\n", "6 columns without names"),
        ("1 2 3 4\n5 6 7\n", "line 2 has 3 columns, not 4"),
        ("x,y,z,i\n1,2,3,4\n5,6,7,8,9\n", "line 3 has 5 columns, not 4"),
        ("x,y,z,i\n1,2,3,4\n5,6,7\n1,2,3,4,5\n", "line 3 has 3 columns, not 4"),
        ("x\ty\tz\ti\n1\t2\t\t4\n5\t6\t7\n", "line 3 has 3 columns, not 4"),
        ("1;2;3;4\n5;6;-;8\n", "line 2 has '-'"),
        ("1 2 3 4\n5 6 no 8\n", "line 2 has 'no'"),
        ("x (deg),y (deg),z\n1,2,3\n", "x (deg), of an unknown unit"),
        ("1,5;2,5;3,5\n", "decimal commas: 1,5"),
        ("x,y,z,x\n1,2,3,4\n", "repeats a column"),
        ("Dear Sir or Madam,\nplease find enclosed\n", "Dear Sir"),
        ("x y z\n1 2 3\n\0\0", "not text"),
        ("12:00:01 1 2 3\n", "line 1 has '12:00:01'"),
        ("x;y;z;i\n1,5;2;3;4\n", "decimal commas: 1,5"),
        ("500000 5600000 100\n500001 5600001 101\n", "x from 500000 to 500001"),
    ):
        path = tmp_path / "s.txt"
        path.write_text(text)
        caught = refused(FormatError, path, read_scan, path)
        assert problem in caught.value.problem
