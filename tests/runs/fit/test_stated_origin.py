# SPDX-License-Identifier: MIT
"""Positions of a sensor that the user states, in the frame of the scans."""

import numpy as np
import pytest
from las_files import write_las
from scans import SMALL, make_scan, write_bin
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli.commands.stages.inspect import inspect
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.fit.stated_origin import origin_in_frame
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_search import find_scans

pytest.importorskip("laspy")
SCAN = make_scan(1500)
POSITION = (500_123.4, 5_400_456.7, 312.0)


def in_map(path, position=POSITION):
    return write_las(path, SCAN.points + np.array(position), offsets=position)


def test_it_is_in_the_local_frame_of_a_map_and_as_stated_in_others(tmp_path):
    files = find_scans(in_map(tmp_path / "map/a.las").parent)
    assert origin_in_frame(POSITION, files, SMALL) == (123.4, 456.7, 312)
    write_bin(tmp_path / "scans/a.bin", SCAN)
    assert origin_in_frame((1, 2, 3), find_scans(tmp_path / "scans"), SMALL) == (1, 2, 3)


def test_a_line_has_the_number_of_scans_of_one_position(tmp_path, caplog):
    caplog.set_level(NOTICE)
    in_map(tmp_path / "map/a.las")
    origin_in_frame(POSITION, find_scans(tmp_path / "map"), SMALL)
    assert "position" not in caplog.text
    in_map(tmp_path / "map/b.las")
    origin_in_frame(POSITION, find_scans(tmp_path / "map"), SMALL)
    assert "the position of the sensor in all 2 scans" in caplog.text


def test_scans_of_several_frames_have_no_common_position(tmp_path):
    in_map(tmp_path / "map/a.las")
    in_map(tmp_path / "map/b.las", (600_123.4, 5_400_456.7, 312.0))
    with pytest.raises(UsageError, match="2 local frames"):
        origin_in_frame(POSITION, find_scans(tmp_path / "map"), SMALL)


def test_a_scan_without_points_has_no_frame(tmp_path):
    (tmp_path / "a.las").touch()
    assert origin_in_frame(POSITION, find_scans(tmp_path), SMALL) == POSITION


def test_predict_labels_from_there_and_records_it(tmp_path, world):
    path = in_map(tmp_path / "map/a.las")
    out = tmp_path / "results"
    assert predict_scans(path.parent, out, settings=world.network, origin=POSITION).done == 1
    sensor = Provenance(out).sensor()
    assert (sensor.origin, sensor.registered) == ((123.4, 456.7, 312), False)
    # As of the same points around their sensor
    write_las(tmp_path / "local/a.las", SCAN.points)
    alone = tmp_path / "alone"
    predict_scans(tmp_path / "local", alone, settings=world.network, origin=(0.0, 0.0, 0.0))
    labels = [np.fromfile(next(folder.rglob("*.label")), "<u4") for folder in (out, alone)]
    assert (labels[0] == labels[1]).mean() > 0.98  # Coordinates are rounded to a millimetre


def test_inspect_measures_from_there(tmp_path):
    path = in_map(tmp_path / "map/a.las")
    survey = inspect(path.parent, sensor=SMALL, as_predict=True, origin=POSITION)
    assert survey.sensor.origin == (123.4, 456.7, 312)
    up, down = survey.total.field_of_view()
    assert 2 < up < 4
    assert -26 < down < -24
