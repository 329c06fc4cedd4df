# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, make_scan, refused, write_bin

from salsanext_cli import Scan, project, read_scan, sensor
from salsanext_cli.commands.stages.inspect import inspect, write_sensor
from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.fitting.field_of_view import fit_view

TILT = np.radians(6.5)


@pytest.fixture
def tilted(tmp_path):
    """Return a folder with a scan that reaches far above what an HDL-64 sees, and that scan."""
    flat = make_scan(4000)
    x, y, z = flat.points.T
    up = np.stack([x * np.cos(TILT) - z * np.sin(TILT), y, x * np.sin(TILT) + z * np.cos(TILT)])
    scan = Scan(np.ascontiguousarray(up.T, np.float32), flat.intensity)
    write_bin(tmp_path / "scans/0.bin", scan)
    return tmp_path / "scans", scan


def test_a_fitted_sensor_is_normalised_through_its_field_of_view(tilted, tmp_path):
    folder, scan = tilted
    quiet = replace(SMALL, range_noise=None)
    fitted = inspect(folder, sensor=quiet, fit=True).fitted_sensor("mine")
    assert fitted.fov_up > SMALL.fov_up + 5
    seen = project(scan, replace(fitted, name="seen")).channels
    occupied = seen[:, seen[0] > 0]
    np.testing.assert_allclose(fitted.means, occupied.mean(axis=1), atol=1e-3)
    np.testing.assert_allclose(fitted.stds, occupied.std(axis=1), atol=1e-3)
    write_sensor(tmp_path / "mine.toml", fitted)
    again = inspect(folder, sensor=sensor(tmp_path / "mine.toml"), fit=True)
    assert again.fitted_sensor("mine") == fitted
    assert (fitted.range_noise, fitted.intensity_noise) == (None, SMALL.intensity_noise)


def test_scans_without_a_field_of_view_are_not_fitted(tmp_path):
    for points, number in (
        (np.zeros((2000, 3)), " 0 points"),
        (make_scan(999).points, "999 points"),
        (make_scan(2000).points * [1, 1, 0.01], r" 0\.\d\d°"),
    ):
        scan = Scan(points.astype(np.float32), np.zeros(len(points), np.float32))
        write_bin(tmp_path / "scans/0.bin", scan)
        inspection = inspect(tmp_path / "scans", sensor=SMALL, fit=True)
        with pytest.raises(NoInputError, match=number):
            inspection.fitted_sensor("mine")


def write_beams(folder, beams):
    """Write a scan of beams, each all around at one range."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 300), np.radians(beams))
    flat = 20 * np.cos(elevation)
    points = (flat * np.cos(azimuth), flat * np.sin(azimuth), 20 * np.sin(elevation))
    points = np.stack([axis.ravel() for axis in points], 1).astype(np.float32)
    write_bin(folder / "0.bin", Scan(points, np.zeros(len(points), np.float32)))
    return folder


def test_a_fit_for_the_images_of_weights_has_the_view_that_auto_takes(tmp_path):
    folder = write_beams(tmp_path / "scans", np.linspace(40, -40, 60))
    found = inspect(folder, sensor=SMALL, fit=True)
    mine = inspect(folder, sensor=SMALL, fit=True, images=False).fitted_sensor("mine", images=False)
    auto = fit_view([read_scan(folder / "0.bin")], SMALL)
    assert (mine.fov_up, mine.fov_down) == (auto.fov_up, auto.fov_down)
    assert mine.fov_up - mine.fov_down < 72
    assert found.fitted_sensor("mine").fov_up == pytest.approx(40, abs=0.1)
    write_sensor(tmp_path / "mine.toml", mine, images=False)
    usual = {"means": SMALL.means, "stds": SMALL.stds}
    assert sensor(tmp_path / "mine.toml", SMALL) == replace(mine, **usual)
    other = replace(mine, fov_up=1.0)
    with refused(OutputError, tmp_path / "mine.toml"):
        write_sensor(tmp_path / "mine.toml", other)
    write_sensor(tmp_path / "mine.toml", other, overwrite=True)
    assert sensor(tmp_path / "mine.toml", SMALL).fov_up == 1.0
