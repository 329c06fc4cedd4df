# SPDX-License-Identifier: MIT
"""The intensity of files that name their fields, under any name."""

import io
import re
from dataclasses import replace

import bags
import numpy as np
import pytest
from scans import SMALL, make_scan, refused

from salsanext_cli import read_scan, write_ply
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.field_names import INTENSITY_NAMES, AxisFields, intensity_among
from salsanext_cli.runs.scans.scan_search import find_scans

SCAN = make_scan(300)
X, Y, Z = SCAN.points.T
ECHO = np.arange(300, dtype="<u2") * 7 % 256
FIELDS = {"x": X, "y": Y, "z": Z, "ring": ECHO % 16, "scalar_Echo": ECHO}


def saved(save, *arrays, **named):
    with io.BytesIO() as buffer:
        save(buffer, *arrays, **named)
        return buffer.getvalue()


def pcd():
    records = np.rec.fromarrays([*FIELDS.values()], names=",".join(FIELDS))
    head = (
        f"VERSION .7\nFIELDS {' '.join(FIELDS)}\nSIZE 4 4 4 2 2\nTYPE F F F U U\n"
        "WIDTH 300\nHEIGHT 1\nDATA binary\n"
    )
    return head.encode() + records.tobytes()


def ply(tmp_path):
    write_ply(tmp_path / "made.ply", FIELDS)
    return (tmp_path / "made.ply").read_bytes()


def csv():
    rows = zip(*(values.tolist() for values in FIELDS.values()), strict=True)
    lines = [",".join(["time", *FIELDS]), *(",".join(map(repr, (5, *row))) for row in rows)]
    return "\n".join(lines).encode()


MADE = {
    "s.pcd": lambda _: pcd(),
    "s.ply": ply,
    "s.csv": lambda _: csv(),
    "s.npz": lambda _: saved(np.savez, **FIELDS),
    "s.npy": lambda _: saved(
        np.save, np.rec.fromarrays([*FIELDS.values()], names=",".join(FIELDS))
    ),
}


@pytest.fixture(params=MADE)
def path(request, tmp_path):
    """Write the same scan in a format."""
    path = tmp_path / request.param
    path.write_bytes(MADE[request.param](tmp_path))
    return path


@pytest.mark.parametrize("name", ["scalar_Echo", "SCALAR_ECHO", "echo"])
def test_a_field_is_read_as_intensity(path, name):
    assert not read_scan(path).intensity.any()
    scan = read_scan(path, replace(SMALL, intensity_field=name, intensity_scale=2.0))
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_array_equal(scan.intensity, ECHO / np.float32(2))


def test_the_error_and_the_warning_name_fields_of_the_file(path):
    with pytest.raises(FormatError) as caught:
        read_scan(path, replace(SMALL, intensity_field="amplitude"))
    warning = check_scan(path, read_scan(path), SMALL, SMALL).findings[-1]
    assert warning.code == "no-intensity"
    for hint in (caught.value.hint, warning.hint):
        (name,) = re.findall('intensity_field="(.*?)"', hint)
        scan = read_scan(path, replace(SMALL, intensity_field=name))
        assert scan.intensity.any()
        assert "scalar_Echo" in caught.value.expected or "scalar_Echo" in hint
    assert "ring" in caught.value.expected


@pytest.mark.parametrize("name", INTENSITY_NAMES)
@pytest.mark.parametrize("spelling", ["{}", "scalar_{}", "Attributes.{}", "{} (%)", '"{}"'])
def test_usual_names_need_no_option(name, spelling):
    written = spelling.format(name.title())
    assert intensity_among(["x", "ring", written], "", "s.csv") == written
    assert intensity_among(["x", "ring", f"{name}_filter"], "", "s.csv") is None


@pytest.mark.parametrize(
    ("names", "axes"),
    [
        ("velocity.x velocity.y velocity.z x y z", "x y z"),
        ("velocity.x velocity.y velocity.z x1 y1 z1", "x1 y1 z1"),
        ("X Y Z x y z", "x y z"),
        ("scalar_x scalar_y scalar_z X Y Z", "X Y Z"),
        ("lidar.x lidar.y lidar.z i", "lidar.x lidar.y lidar.z"),
    ],
)
def test_exact_names_of_coordinates_precede_bare_ones_and_prefixed_ones_are_last(names, axes):
    for order in (names.split(), names.split()[::-1]):
        assert AxisFields.among(order, "s.csv").names == tuple(axes.split())


@pytest.mark.parametrize(
    "names", ["a.x a.y a.z b.x b.y b.z", "a.x b.y c.z", "velocity.x y z", "normal.x"]
)
def test_coordinates_of_several_prefixes_are_refused(names):
    refused(FormatError, "s.csv", AxisFields.among, names.split(), "s.csv")


@pytest.mark.parametrize(
    ("names", "intensity"),
    [
        ("noise.intensity intensity", "intensity"),
        ("noise.intensity Intensity intensity", "intensity"),
        ("noise.intensity reflectivity", "reflectivity"),
        ("scalar_intensity Intensity", "Intensity"),
        ("noise.intensity ring", "noise.intensity"),
    ],
)
def test_exact_names_of_the_intensity_precede_prefixed_ones(names, intensity):
    for order in (names.split(), names.split()[::-1]):
        assert intensity_among(order, "", "s.csv") == intensity


def test_attributes_beside_a_table_are_no_coordinates(tmp_path):
    path = tmp_path / "s.npz"
    attributes = {f"pcloud_attr.{axis}": np.zeros(300, np.float32) for axis in "xyz"}
    echo = {"pcloud_attr.reflectance": ECHO.astype("f4")}
    np.savez(path, **attributes, pcloud_points=SCAN.points, **echo)
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_array_equal(scan.intensity, ECHO)
    records = np.rec.fromarrays([0 * X, 0 * X, 0 * X, X, Y, Z], names="a,b,c,x,y,z")
    records.dtype.names = ("normal.x", "normal.y", "normal.z", "x", "y", "z")
    np.save(tmp_path / "s.npy", records)
    np.testing.assert_array_equal(read_scan(tmp_path / "s.npy").points, SCAN.points)


def test_clouds_of_bags_have_names_too(tmp_path):
    pytest.importorskip("rosbags")
    points = bags.structured(200)
    bag = bags.write_bag(tmp_path, ".bag", bags.messages([points]))
    (file,) = find_scans(bag)
    scan = read_scan(file.path, replace(SMALL, intensity_field="RING"))
    np.testing.assert_array_equal(scan.intensity, points["ring"])
    with pytest.raises(FormatError, match="ring"):
        read_scan(file.path, replace(SMALL, intensity_field="echo"))


def test_names_of_columns_can_be_chosen_too(tmp_path):
    path = tmp_path / "s.xyz"
    path.write_text("1 2 3 4 5 6\n")
    named = replace(SMALL, columns=("x", "y", "z", "_", "a", "b"), intensity_field="b")
    assert read_scan(path, named).intensity.tolist() == [6]


def test_unclear_and_textual_fields_are_refused(tmp_path):
    path = tmp_path / "s.npz"
    labels = np.full(300, "car")
    np.savez(path, x=X, y=Y, z=Z, ECHO=ECHO, Echo=ECHO, label=labels)
    for name in ("echo", "label", "x"):
        field = replace(SMALL, intensity_field=name) if name != "x" else SMALL
        if name == "x":
            assert not read_scan(path, field).intensity.any()
            continue
        with pytest.raises(FormatError, match="one of ECHO, Echo"):
            read_scan(path, field)
    assert read_scan(path, replace(SMALL, intensity_field="Echo")).intensity.any()
