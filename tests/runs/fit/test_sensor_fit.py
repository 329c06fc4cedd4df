# SPDX-License-Identifier: MIT
"""The fit of a run is that of its scans, and what its settings allow."""

import numpy as np
import pytest
from scans import SMALL, make_scan, write_bin, write_weights
from street_scans import moved, street

from salsanext_cli import fit_network, load_network, read_scan
from salsanext_cli.runs.fit.sensor_fit import (
    fit_settings,
    fitted_view,
    network_of_run,
    settings_of_network,
)
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.scans.scan_search import find_scans

PLACE = (-90, 40, 3)


@pytest.fixture(scope="module")
def narrow_file(tmp_path_factory):
    """Return weights of few channels."""
    from narrow_network import narrow_salsanext

    with narrow_salsanext():
        yield write_weights(tmp_path_factory.mktemp("narrow") / "w.safetensors", sensor=SMALL)


@pytest.fixture
def folder(tmp_path):
    """Return scans of a sensor that lies elsewhere than the origin of its files."""
    for number in range(3):
        scan = moved(street(0, seed=number), PLACE)
        write_bin(tmp_path / f"{number}.bin", scan)
    return tmp_path


def test_a_folder_and_its_scans_in_memory_have_one_fit(folder, narrow_file):
    network = load_network(narrow_file, "cpu", engine="torch")
    scans = [read_scan(path) for path in sorted(folder.glob("*.bin"))]
    of_folder = fit_network(network, folder)
    of_scans = fit_network(network, scans)
    assert of_folder.sensor == of_scans.sensor
    np.testing.assert_allclose(of_folder.sensor.origin[:2], PLACE[:2], atol=0.6)
    assert fit_network(network, folder, view=False).sensor.origin == network.sensor.origin


def test_a_run_has_the_fit_of_its_scans(folder, narrow_file, tmp_path):
    settings = NetworkSettings(narrow_file, "cpu", engine="torch")
    network = settings.load()
    fitted = network_of_run(settings, network, find_scans(folder), tmp_path / "out")
    assert fitted.sensor == fit_network(network, folder).sensor
    view = fitted_view(find_scans(folder), network.sensor)
    assert (view.fov_up, view.fov_down) == (fitted.sensor.fov_up, fitted.sensor.fov_down)


@pytest.mark.parametrize("sensor", [None, "auto", SMALL])
def test_a_sensor_that_is_stated_stays(sensor, narrow_file):
    settings = fit_settings(NetworkSettings(narrow_file, sensor=sensor))
    assert settings.view is (sensor is not SMALL)
    assert settings.named == (SMALL if sensor is SMALL else None)
    assert not settings.is_width_named


def test_the_settings_of_a_network_name_its_weights_and_its_sensor(narrow_file):
    network = NetworkSettings(narrow_file, "cpu", engine="torch").load()
    settings = settings_of_network(network, PredictSettings)
    assert settings.weights == network.backend.sha256
    assert settings.engine == "torch"
    assert settings.sensor == SMALL.without_noise()
    assert settings.label_space.fits(network.space)


def test_a_scan_that_fits_needs_no_other_sensor(tmp_path, narrow_file):
    write_bin(tmp_path / "a.bin", make_scan())
    network = load_network(narrow_file, "cpu", engine="torch")
    sensor = fit_network(network, tmp_path).sensor
    assert sensor.origin in (None, (0.0, 0.0, 0.0))
    assert (sensor.height, sensor.width) == (SMALL.height, SMALL.width)
