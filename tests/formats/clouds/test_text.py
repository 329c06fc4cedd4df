# SPDX-License-Identifier: MIT
"""Tables of text as many programs write them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL, refused

from salsanext_cli import read_scan
from salsanext_cli.errors import FormatError

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
        ("x,y,z,i\n1,2,3,4\n5,6,7,8,9\n", "more or fewer than 4 columns"),
        ("1;2;3;4\n5;6;;8\n", "line 2 has ''"),
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
