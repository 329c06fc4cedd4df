# SPDX-License-Identifier: MIT
import numpy as np
import open3d
import pytest
from scans import make_scan

from salsanext_cli.io.formats.pcd import pcd_columns
from salsanext_cli.io.formats.pcd_writing import encode_pcd


@pytest.mark.parametrize("text", [True, False])
def test_open3d_and_the_reader_get_every_value(tmp_path, text):
    points = make_scan(200).points
    points[7] = [np.nan, np.inf, -0.0]
    labels = np.arange(200, dtype=np.uint16) + 1000
    path = tmp_path / "a.pcd"
    path.write_bytes(
        encode_pcd({**dict(zip("xyz", points.T, strict=True)), "labels": labels}, text=text)
    )
    columns = pcd_columns(path)
    np.testing.assert_array_equal(np.column_stack([columns[axis] for axis in "xyz"]), points)
    np.testing.assert_array_equal(columns["labels"], labels)
    cloud = open3d.t.io.read_point_cloud(str(path))
    finite = np.arange(200) != 7
    np.testing.assert_array_equal(cloud.point.positions.numpy()[finite], points[finite])
    np.testing.assert_array_equal(cloud.point["labels"].numpy()[:, 0], labels)
