# SPDX-License-Identifier: MIT
import json
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import project, read_scan
from salsanext_cli.errors import OutputError
from salsanext_cli.fitting.label_scan import projected_sensor
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import RunOptions
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


def test_another_sensor_is_refused(world):
    project_scans(world.data, world.out, sensor=SMALL, selection=ScanSelection(limit=1))
    with pytest.raises(OutputError, match=r"sensor\.width was 128 and is 64"):
        project_scans(world.data, world.out, sensor=SMALL.resized(width=64))
    options = RunOptions(overwrite=True)
    project_scans(world.data, world.out, sensor=SMALL.resized(width=64), options=options)
    assert np.load(world.result("range")).shape == (5, 16, 64)
