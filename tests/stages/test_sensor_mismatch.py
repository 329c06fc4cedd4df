# SPDX-License-Identifier: MIT
"""Stages warn when scans come from another sensor than the one that was named."""

from dataclasses import replace

import pytest
from scans import SMALL

from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.sensors.sensor import sensor
from salsanext_cli.stages.inspect import inspect
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.project import project_scans

UPWARDS = replace(SMALL, name="upwards", fov_up=30.0, fov_down=-2.0)


def run(stage, world, view, **options):
    how = RunOptions(**options)
    if stage == "project":
        project_scans(world.data, world.out, sensor=view, options=how)
    elif stage == "inspect":
        inspect(world.data, sensor=view, options=how)
    else:
        network = replace(world.network, sensor=view)
        predict_scans(world.data, world.out, network=network, options=how)


@pytest.mark.parametrize(
    ("stage", "jobs"), [("project", 1), ("project", 2), ("inspect", 1), ("predict", 1)]
)
def test_scans_of_another_sensor_cause_one_warning(world, caplog, stage, jobs):
    run(stage, world, UPWARDS, jobs=jobs)
    (said,) = [text for text in caplog.messages if "outside the view of upwards" in text]
    assert "lie outside the view of upwards, +30° to -2°" in said
    assert "--sensor" in said
    assert "inspect SCANS --fit" in said


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
