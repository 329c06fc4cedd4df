# SPDX-License-Identifier: MIT
"""Scans in the frame of a vehicle or a map: fit, warning, stages."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calls import calls_of
from map_drives import WAY, drive, write_poses
from scans import SMALL, labels_below, write_bin, write_weights
from street_scans import HEIGHT, low_street, moved, street

from salsanext_cli import Scan, read_scan
from salsanext_cli.commands.stages.fuse import fuse_results
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.pick import pick
from salsanext_cli.commands.stages.picture import picture
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.tune import tune_int8
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fitting.mounting_fit import fit_mounting
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.fitting.view_fit import fit_sensor
from salsanext_cli.core.geometry.sensor_of_scan import placed_sensor, sensor_of
from salsanext_cli.core.measures.expected_accuracy import WITHHELD_FOR
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.fit.scan_reading import read_prepared
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.folder_names import ORIGINS
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.recorded_origins import recorded_origin
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

DOWN = np.diag([1.0, -1, -1])


def upside_down(scan: Scan) -> Scan:
    return Scan((scan.points @ DOWN).astype(np.float32), scan.intensity)


def codes(scan: Scan, sensor: Sensor) -> dict[str, str]:
    """Return the hints of a scan by code."""
    findings = check_scan(Path("s.bin"), scan, sensor, SMALL).findings
    return {finding.code: finding.hint for finding in findings}


@pytest.mark.parametrize("place", [(16, 12, 0), (5.2, 0, HEIGHT), (-90, 40, 3)])
def test_one_origin_of_all_scans(place):
    scans = [moved(street(0, seed=seed), place) for seed in range(3)]
    sensor = fit_mounting(scans, SMALL)
    assert np.hypot(*(np.array(sensor.origin) - place)[:2]) < 0.6
    assert sensor.origin[2] == pytest.approx(place[2], abs=0.25)
    assert not sensor.registered
    assert all("out-of-place" not in codes(scan, sensor) for scan in scans)


@pytest.mark.parametrize("height", [0.0, 0.7, 1.2])
def test_bodies_with_z_down(height):
    """Their origin is below the sensor, which is 1.7 m above the ground."""
    scan = upside_down(moved(street(0), (0.5, 0, height)))
    sensor = fit_mounting([scan], SMALL)
    assert sensor.up[2] < -0.99
    assert sensor.origin[2] == pytest.approx(-height, abs=0.35 if height else 0.1)


@pytest.mark.slow
def test_scans_of_a_map_are_of_one_sensor_with_an_origin_each():
    sensor = fit_sensor(ScanSample.from_scans(drive()), SMALL)
    assert sensor.registered
    assert sensor.others == ()
    for scan, place in zip(drive(), WAY, strict=True):
        placed = sensor_of(scan, sensor)
        assert np.abs(np.array(placed.origin) - place).max() < 0.6
        assert "out-of-place" not in codes(scan, placed)
    assert len({check_scan(Path(), s, sensor_of(s, sensor)).traits.sensor for s in drive()}) == 1


def test_drives_in_the_frame_of_their_sensor_stay_so():
    scans = [street(32, seed=seed) for seed in range(4)]
    assert fit_mounting(scans, SMALL) == SMALL


@pytest.mark.parametrize("side", [np.eye(3), DOWN])
def test_the_hint_of_the_warning_works(side):
    scan = moved(street(0), (30, -20, 1))
    scan = Scan((scan.points @ side).astype(np.float32), scan.intensity)
    sensor = replace(SMALL, name="mine")
    hint = codes(scan, sensor)["out-of-place"]
    numbers = dict(re.findall(r"(up|origin) = \[([-0-9., ]+)\]", hint))
    values = {key: tuple(float(word) for word in numbers[key].split(",")) for key in numbers}
    assert ("up" in values) == (side is DOWN)
    assert "out-of-place" not in codes(scan, replace(sensor, **values))
    assert "out-of-place" in WITHHELD_FOR


def test_the_hint_about_a_scan_of_a_map_does_not_move_the_others():
    scan = moved(street(32), (30, 10, 0))
    wrong = replace(SMALL, name="fitted", registered=True, origin=(15.0, 10.0, 0.0))
    hint = codes(scan, wrong)["out-of-place"]
    assert "file for sensor" not in hint
    assert "pose" in hint
    assert "alone" in hint
    assert "out-of-place" not in codes(scan, fit_sensor(ScanSample.from_scans([scan]), SMALL))


def test_a_sensor_file_with_only_up_leads_to_the_origin():
    scan = upside_down(moved(street(0), (0.4, 0, 1.2)))
    hints = codes(scan, replace(SMALL, name="mine", up=(0.0, 0.0, -1.0)))
    assert "origin" in {**hints}.get("out-of-place", hints.get("height", ""))


@pytest.mark.parametrize("angle", [0.35, 0.8])
def test_narrow_fields_of_view_and_low_sensors_are_not_out_of_place(angle):
    scan = street(32)
    ahead = scan.take(np.flatnonzero(np.abs(np.arctan2(*scan.points.T[1::-1])) < angle))
    assert "out-of-place" not in codes(ahead, SMALL)
    for height in (0.5, HEIGHT, 4.0):
        assert "out-of-place" not in codes(street(32, height), SMALL)


@pytest.mark.slow
def test_every_stage_sees_a_registered_drive_from_its_sensor(map_drive, tmp_path):
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    source, out, steps = map_drive / "velodyne", tmp_path / "out", tmp_path / "steps"
    predict_scans(source, out, settings=network, extras=("probabilities",))
    project_scans(source, steps, sensor=SMALL, fit=True)
    predict_range_images(steps, steps, settings=network)
    knn_refine_scans(steps)
    labels = labels_below(out)
    assert len(labels) == len(WAY)
    assert labels == labels_below(steps)
    fuse_results(out)


STATISTICS = replace(
    SMALL, intensity_quantiles=tuple(np.linspace(0, 1, INTENSITY_LEVELS).tolist()), row_gaps=0.0
)
"""Sensor of weights whose network depends on the intensity and the gaps of the images."""


def require_same_results_in_three_stages(source: Path, weights: Path, folder: Path) -> None:
    """Require the labels, and the fit, of `predict` and of the three stages to be the same."""
    write_weights(weights, sensor=STATISTICS)
    network = NetworkSettings(weights, "cpu", engine="torch")
    out = folder / "out"
    steps = folder / "steps"
    predict_scans(source, out, settings=network)
    project_scans(source, steps, sensor=SMALL, fit=True)
    predict_range_images(steps, steps, settings=network)
    knn_refine_scans(steps)
    fit = Manifest(out).settings("predict").sensor
    assert fit.has_registered
    assert fit.intensity_quantiles != STATISTICS.intensity_quantiles
    assert Manifest(steps).settings("predict").sensor == fit
    labels = labels_below(out)
    assert len(labels) == len(find_scans(source))
    assert labels == labels_below(steps)
    for file in find_scans(source):
        assert recorded_origin(out, file, fit) == recorded_origin(steps, file, fit)


@pytest.mark.parametrize("has_poses", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.usefixtures("workers_in_process")
def test_three_stages_give_the_labels_of_predict(map_drive, tmp_path, has_poses):
    """The poses are those of another point of the vehicle, near the place that the points show."""
    shutil.copytree(map_drive / "velodyne", tmp_path / "velodyne")
    if has_poses:
        write_poses(tmp_path / "poses.txt", np.array(WAY, float) + (0.4, -0.3, 0.2))
    weights = tmp_path / "w.safetensors"
    require_same_results_in_three_stages(tmp_path / "velodyne", weights, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("has_poses", [False, True])
@pytest.mark.usefixtures("workers_in_process")
def test_three_stages_give_the_labels_of_predict_for_several_sensors(tmp_path, has_poses):
    places = np.array([*WAY[:3], (0, 0, 0), (0, 0, 0)], float)
    seeds = enumerate([street(32, seed=seed) for seed in range(3)])
    scans = [moved(scan, places[number]) for number, scan in seeds]
    scans += [low_street(seed) for seed in (10, 11)]
    for number, scan in enumerate(scans):
        write_bin(tmp_path / "velodyne" / f"{number:06}.bin", scan)
    if has_poses:
        write_poses(tmp_path / "poses.txt", places + (0.4, -0.3, 0.2))
    weights = tmp_path / "w.safetensors"
    require_same_results_in_three_stages(tmp_path / "velodyne", weights, tmp_path)
    assert len(Manifest(tmp_path / "out").settings("predict").sensor.members) == 2


@pytest.mark.usefixtures("workers_in_process")
def test_pick_and_tune_see_scans_from_the_poses_that_predict_uses(map_drive, tmp_path):
    shutil.copytree(map_drive / "velodyne", tmp_path / "velodyne")
    places = np.array(WAY, float) + (0.4, -0.3, 0.2)
    write_poses(tmp_path / "poses.txt", places)
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    scans = find_scans(tmp_path / "velodyne")
    expected = dict(zip([scan.name for scan in scans], map(tuple, places.tolist()), strict=True))
    with calls_of(read_prepared) as prepared:
        one = ScanSelection(limit=1)
        target = tmp_path / "int8.safetensors"
        tune_int8(tmp_path / "velodyne", target, settings=network, selection=one)
        pick(tmp_path / "velodyne", tmp_path / "picked", count=1, settings=network)
    # Int8 is fitted to one scan. All are described, and one of them is written.
    assert len(prepared) == 1 + len(scans) + 1
    for call in prepared:
        assert call["origin"] == pytest.approx(expected[call["file"].name])


def test_the_origin_of_each_scan_is_recorded(predicted_map, tmp_path):
    results = ResultFolder(predicted_map)
    sensor = results.provenance.sensor()
    assert ORIGINS in results.manifest.record("predict").writes
    for file, place in zip(results.scans(), WAY, strict=True):
        array = np.load(output_path(predicted_map, file.sequence, ORIGINS, file.stem))
        assert (array.shape, array.dtype) == ((3,), np.float64)
        assert np.abs(array - place).max() < 0.6
        origin = recorded_origin(predicted_map, file, sensor)
        assert origin == sensor_of(read_scan(file.path), sensor).origin
        assert recorded_origin(predicted_map, file, SMALL) is None
        assert recorded_origin(tmp_path, file, sensor) is None


@pytest.mark.usefixtures("workers_in_process", "undrawn")
def test_later_stages_search_no_origin(map_drive, predicted_map, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(predicted_map, out)
    scan, sensor = ResultFolder(out).scans()[1], ResultFolder(out).provenance.sensor()
    before = ResultFolder(out).read(scan, sensor)

    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    few = UncertaintyMethod(samples=2, aleatoric="none")
    with calls_of(placed_sensor) as searches:
        outcome = uncertainty(map_drive / "velodyne", out, settings=network, method=few)
        assert outcome.done == len(WAY)
        assert picture(out, colours=("range",)).done == len(WAY)
        assert fuse_results(out).done == len(WAY)
        for folder in (out, out / "fused"):
            assert ResultFolder(folder).read(scan, sensor).sensor == before.sensor
        assert knn_refine_scans(out, options=RunOptions(overwrite=True)).done == len(WAY)
    assert not searches


@pytest.mark.parametrize("content", [np.zeros(2), np.full(3, np.nan), np.zeros(3, np.float32)])
def test_a_damaged_origin_is_refused(predicted_map, tmp_path, content):
    file, sensor = (
        ResultFolder(predicted_map).scans()[0],
        ResultFolder(predicted_map).provenance.sensor(),
    )
    path = output_path(tmp_path, file.sequence, ORIGINS, file.stem)
    path.parent.mkdir(parents=True)
    np.save(path, content)
    with pytest.raises(FormatError) as caught:
        recorded_origin(tmp_path, file, sensor)
    assert caught.value.subject == str(path)
    assert caught.value.hint.startswith("delete it and run")


@pytest.mark.slow
@pytest.mark.usefixtures("workers_in_process")
def test_recorded_origins_stay_when_poses_appear(map_drive, tmp_path, caplog):
    """Neither a run with nothing to do nor one of another stage records or reads others."""
    source = tmp_path / "velodyne"
    shutil.copytree(map_drive / "velodyne", source)
    weights = tmp_path / "w.safetensors"
    write_weights(weights, sensor=STATISTICS)
    network = NetworkSettings(weights, "cpu", engine="torch")
    out = tmp_path / "out"
    project_scans(source, out, sensor=SMALL, fit=True)
    sensor = Manifest(out).settings("project").sensor
    files = find_scans(source)
    before = [recorded_origin(out, file, sensor) for file in files]
    write_poses(tmp_path / "poses.txt", np.array(WAY, float) + (0.4, -0.3, 0.2))
    caplog.set_level("INFO")
    assert project_scans(source, out, sensor=SMALL, fit=True).done == 0
    predict_scans(source, out, settings=network)
    assert "poses.txt" not in caplog.text
    assert [recorded_origin(out, file, sensor) for file in files] == before
    (tmp_path / "poses.txt").unlink()
    predict_scans(source, tmp_path / "without", settings=network)
    assert labels_below(out) == labels_below(tmp_path / "without")


@pytest.mark.usefixtures("workers_in_process")
def test_the_hint_about_a_damaged_origin_works(map_drive, predicted_map, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(predicted_map, out)
    results = ResultFolder(out)
    file = results.scans()[1]
    path = output_path(out, file.sequence, ORIGINS, file.stem)
    content = path.read_bytes()
    path.write_bytes(b"damaged")
    with pytest.raises(FormatError) as caught:
        recorded_origin(out, file, results.provenance.sensor())
    assert caught.value.hint == "delete it and run `salsanext predict` again, which writes it"
    path.unlink()
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    extras = ("probabilities", "pixel_labels")
    again = predict_scans(map_drive / "velodyne", out, settings=network, extras=extras)
    assert again.done == 1
    assert path.read_bytes() == content


def test_scans_at_the_sensor_have_no_origins(map_drive, tmp_path):
    scans, out = tmp_path / "scans", tmp_path / "out"
    for number in range(2):
        write_bin(scans / f"{number}.bin", street(32, seed=number))
    network = NetworkSettings(map_drive / "w.safetensors", "cpu", engine="torch")
    predict_scans(scans, out, settings=network)
    assert not list(out.glob(f"sequences/*/{ORIGINS}"))
