# SPDX-License-Identifier: MIT
import json
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import project, read_scan
from salsanext_cli.fitting.label_scan import projected_sensor
from salsanext_cli.sensors.sensor import sensor
from salsanext_cli.stages.project import project_scans


def test_the_files_hold_the_projection(world):
    outcome = project_scans(world.data, world.out, sensor=SMALL)
    assert outcome.done == 3
    seen = replace(SMALL, min_range=1.0, ego_box=())
    image = project(read_scan(world.scan("08", "000001")), seen)
    channels = np.load(world.result("range", "08", "000001"))
    pixels = np.load(world.result("pixels", "08", "000001"))
    assert channels.dtype == np.float32
    assert pixels.dtype == np.int32
    np.testing.assert_array_equal(channels, image.channels)
    np.testing.assert_array_equal(pixels, image.pixel_of_point)
    assert json.loads((world.out / "project.json").read_text())["settings"] == {
        "sensor": json.loads(json.dumps(seen.to_dict()))
    }
    assert projected_sensor(world.out) == seen
    assert projected_sensor(world.data) is None


@pytest.mark.real
@pytest.mark.parametrize(
    ("folder", "preset", "fits"),
    [
        ("semantickitti/sequences/08", "hdl64", True),
        ("pandaset/sequences/002/velodyne/000000.bin", "pandar64", True),
        ("sensors/nuscenes_hdl32/five_columns.pcd.bin", "hdl32", True),
        ("sensors/ouster/os0_128.bin", "os0-128", True),
        ("sensors/ouster/os2_32.bin", "os2-32", True),
        ("sensors/pcd/hdl32_with_points_at_origin.pcd", "hdl32", True),
        ("semantickitti/sequences/08", "vlp16", False),
        ("sensors/ouster/os1_128.bin", "os2-32", False),
    ],
)
def test_real_scans_fit_their_sensors_only(real_data, tmp_path, caplog, folder, preset, fits):
    project_scans(real_data / "data" / folder, tmp_path, sensor=sensor(preset))
    assert caplog.text.count("outside the view") == (0 if fits else 1)
