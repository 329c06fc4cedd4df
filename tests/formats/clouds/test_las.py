# SPDX-License-Identifier: MIT
"""LAS and LAZ files that laspy wrote."""

import sys

import numpy as np
import pytest
from scans import make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.errors import FormatError, MissingDependency
from salsanext_cli.files.reading import PANIC

laspy = pytest.importorskip("laspy")
lazrs = pytest.importorskip("lazrs")
SUFFIXES = (".las", ".laz")


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
    with pytest.raises(FormatError, match="x from 500000 to 500001"):
        read_scan(path)
    cloud = laspy.create()
    cloud.x = cloud.y = cloud.z = np.random.default_rng(0).normal(0, 9, 5000)
    cloud.write(path)
    content = path.read_bytes()
    for length in (len(content) // 2, 300, 100, 4, 0):
        path.write_bytes(content[:length])
        with pytest.raises(FormatError, match="damaged or cut off"):
            read_scan(path)


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
    with pytest.raises(FormatError, match="at least one LazItem"):
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
            with pytest.raises(FormatError, match="degrees"):
                read_scan(path)
        else:
            assert len(read_scan(path)) == 9


def test_a_newer_version_is_named(tmp_path):
    path = tmp_path / "s.laz"
    laspy.create().write(path)
    content = path.read_bytes()
    path.write_bytes(content[:24] + b"\1\5" + content[26:])
    with pytest.raises(FormatError, match=r"1\.5 \(expected LAS 1\.0 to 1\.4\)"):
        read_scan(path)


@pytest.mark.parametrize(
    ("name", "suffix"), [("laspy", ".laz"), ("lazrs", ".laz"), ("lazrs", ".las")]
)
def test_a_missing_package_is_named_with_the_file(tmp_path, monkeypatch, name, suffix):
    path = tmp_path / f"drive{suffix}"
    laspy.create().write(tmp_path / "s.laz")
    (tmp_path / "s.laz").rename(path)
    monkeypatch.setitem(sys.modules, name, None)
    caught = refused(MissingDependency, path, read_scan, path)
    assert name in caught.value.problem
    assert caught.value.hint == "pip install 'salsanext[las]'"
