# SPDX-License-Identifier: MIT
"""Stages warn when scans come from another sensor than the one that was named."""

import pytest

from salsanext_cli.sensors.sensor import sensor
from salsanext_cli.stages.project import project_scans


@pytest.mark.real
@pytest.mark.parametrize(
    ("folder", "preset", "fits"),
    [
        ("semantickitti/sequences/08", "hdl64", True),
        ("semantickitti/sequences/x1", "hdl64", True),
        ("semantickitti/sequences/x2", "hdl64", True),
        ("pandaset/sequences/002/velodyne/000000.bin", "pandar64", True),
        ("sensors/nuscenes_hdl32/five_columns.pcd.bin", "hdl32", True),
        ("sensors/nuscenes_hdl32/four_columns", "hdl32", True),
        ("sensors/ouster/os0_128.bin", "os0-128", True),
        ("sensors/ouster/os1_128.bin", "os1-128", True),
        ("sensors/ouster/os2_32.bin", "os2-32", True),
        ("sensors/pcd/hdl64.pcd", "hdl64", True),
        ("sensors/pcd/hdl32_with_points_at_origin.pcd", "hdl32", True),
        ("sensors/ply/hdl32_scalar_intensity.ply", "hdl32", True),
        ("semantickitti/sequences/08", "vlp16", False),
        ("sensors/nuscenes_hdl32/four_columns", "hdl64", False),
        ("sensors/ouster/os0_128.bin", "hdl64", False),
        ("sensors/ouster/os1_128.bin", "os2-32", False),
    ],
)
def test_real_scans_fit_their_sensors_only(real_data, tmp_path, caplog, folder, preset, fits):
    project_scans(real_data / "data" / folder, tmp_path, sensor=sensor(preset))
    assert caplog.text.count("outside the view") == (0 if fits else 1)
