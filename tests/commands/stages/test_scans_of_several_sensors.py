# SPDX-License-Identifier: MIT
"""Scans of several sensors in one folder are labelled as in separate folders."""

from dataclasses import replace

import numpy as np
import pytest
from calls import calls_of
from command_line import called, only_json
from scans import SMALL, files_below, labels_below, make_scan, write_bin, write_weights

from salsanext_cli import Scan, read_scan
from salsanext_cli.commands.stages.inspect import inspect
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.report import read_run
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import NoInputError, UsageError
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame, upright_rotation
from salsanext_cli.core.network.card import AccuracyLine
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

LEANING = upright_rotation(np.array([0.5, 0.0, 0.866]))
TRAINED = replace(SMALL, intensity_quantiles=tuple(np.linspace(0, 1, INTENSITY_LEVELS) ** 2))


def leaning(seed):
    """Return a scan of a sensor that leans by 30° and writes bytes."""
    scan = make_scan(1500, seed)
    points = (scan.points @ LEANING).astype(np.float32)
    return Scan(points, (200 * scan.intensity**3).astype(np.float32))


def level(seed):
    return make_scan(4500, seed)


@pytest.fixture
def mixed(tmp_path):
    """Return a folder of three level and two leaning scans."""
    for number, make in enumerate((level, leaning, level, leaning, level)):
        write_bin(tmp_path / f"mixed/{number}.bin", make(number))
    return tmp_path / "mixed"


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    file = write_weights(tmp_path_factory.mktemp("trained") / "w.safetensors", sensor=TRAINED)
    return NetworkSettings(file, engine="torch")


@pytest.fixture
def apart(tmp_path, mixed, network):
    """Return the labels of the same scans, predicted in a folder for each sensor."""
    for name, stems in (("level", "024"), ("leaning", "13")):
        for stem in stems:
            write_bin(tmp_path / name / f"{stem}.bin", read_scan(mixed / f"{stem}.bin"))
        predict_scans(tmp_path / name, tmp_path / f"out-{name}", settings=network)
    found = labels_below(tmp_path / "out-level") | labels_below(tmp_path / "out-leaning")
    return {f"sequences/mixed/{name.split('/', 2)[2]}": data for name, data in found.items()}


def test_labels_are_those_of_separate_folders(mixed, network, apart, tmp_path, caplog):
    out = tmp_path / "out"
    caplog.set_level("INFO")
    outcome = predict_scans(mixed, out, settings=network)
    assert labels_below(out) == apart
    assert "sensor 1 of 2: 3 scans, such as mixed/0" in caplog.text
    assert "sensor 2 of 2: 2 scans, such as mixed/1" in caplog.text
    assert "mixed-sensors" not in outcome.summary.findings.by_code
    assert predict_scans(mixed, out, settings=network).skipped == 5
    few = UncertaintyMethod(samples=2, aleatoric="none")
    assert uncertainty(mixed, out, settings=network, method=few).done == 5


@pytest.mark.usefixtures("workers_in_process")
def test_parts_steps_workers_and_batches_give_the_same(mixed, network, apart, tmp_path):
    parts, steps, batched = (tmp_path / name for name in ("parts", "steps", "batched"))
    predict_scans(mixed, parts, settings=network, selection=ScanSelection(limit=1))
    for number in (1, 2):
        options = RunOptions(shard=Shard(number, 2), jobs=2)
        predict_scans(mixed, parts, settings=network, options=options)
    project_scans(mixed, steps, sensor=SMALL, fit=True)
    predict_range_images(steps, steps, settings=network)
    knn_refine_scans(steps)
    predict_scans(mixed, batched, settings=network, batch=3)
    for out in (parts, steps, batched):
        assert labels_below(out) == apart
    name = "predict.json"
    assert files_below(parts)[name] == files_below(batched)[name]


def test_sensors_of_one_view_have_their_own_intensities_in_steps_too(mixed, network, tmp_path):
    fixed = replace(TRAINED, min_range=0.0, ego_box=())
    settings = replace(network, sensor=fixed)
    predict_scans(mixed, tmp_path / "out", settings=settings)
    project_scans(mixed, tmp_path / "steps", sensor=fixed)
    predict_range_images(tmp_path / "steps", tmp_path / "steps", settings=settings)
    knn_refine_scans(tmp_path / "steps")
    assert labels_below(tmp_path / "steps") == labels_below(tmp_path / "out")


def test_later_stages_use_the_sensor_of_each_scan(mixed, network, tmp_path):
    """By their height: seen upright, hardly a point is below the ground."""
    predict_scans(mixed, tmp_path / "out", settings=network)
    results = ResultFolder(tmp_path / "out")
    for file in results.scans():
        read = results.read(file, results.provenance.sensor())
        assert (read.sensor.name == "fitted") == (file.stem in "13")
        upright = in_sensor_frame(read.scan, read.sensor).points
        assert np.quantile(upright[:, 2], 0.02) > -1.9
        assert read.range == pytest.approx(measured_ranges(read.scan.points)[0], abs=1e-4)


def test_scans_that_come_later_are_of_one_of_the_sensors(mixed, network, tmp_path):
    out = tmp_path / "out"
    predict_scans(mixed, out, settings=network)
    before = Provenance(out).recorded_sensor()
    write_bin(mixed / "9.bin", leaning(9))
    assert predict_scans(mixed, out, settings=network).done == 1
    assert Provenance(out).recorded_sensor() == before
    (later,) = (file for file in find_scans(mixed) if file.stem == "9")
    assert ResultFolder(out).read(later, before).sensor == before.others[0]


def test_one_sensor_is_recorded_as_before(network, tmp_path):
    for number in range(3):
        write_bin(tmp_path / f"one/{number}.bin", level(number))
    predict_scans(tmp_path / "one", tmp_path / "out", settings=network)
    recorded = Manifest(tmp_path / "out").settings("predict").sensor
    assert (recorded.others, recorded.traits) == ((), ())


def test_a_scan_of_another_sensor_outside_the_sample_is_named(tmp_path):
    for number in range(24):
        write_bin(tmp_path / f"many/{number:02}.bin", (leaning if number == 1 else level)(number))
    outcome = project_scans(tmp_path / "many", tmp_path / "out", sensor=SMALL, fit=True)
    names = [name for name, _ in outcome.summary.findings.by_code["mixed-sensors"]]
    assert names == ["many/01"]


def test_no_accuracy_is_estimated_beside_scans_of_another_sensor(network, tmp_path, narrow_default):
    """Whether the warning arose in this run, in another shard, or in an earlier run."""
    many, out, file = tmp_path / "many", tmp_path / "out", tmp_path / "line.safetensors"
    for number in range(24):
        write_bin(many / f"{number:02}.bin", (leaning if number == 1 else level)(number))
    card = replace(read_card(network.weights), accuracy=AccuracyLine(1.0, 0.0, 0.05))
    save_with_card(network.weights, file, card)
    network = replace(network, weights=file)

    def estimate(**options):
        return predict_scans(many, out, settings=network, **options).summary.expected_accuracy()

    last, first = (RunOptions(shard=Shard(number, 12)) for number in (12, 1))
    assert estimate(options=last).scans == 2
    of_first = estimate(options=first)
    assert of_first.accuracy is None
    assert of_first.withheld["mixed-sensors"] == 1
    next_shard = estimate(options=RunOptions(shard=Shard(2, 12)))
    assert (next_shard.accuracy, next_shard.withheld) == (None, {"mixed-sensors": 1})
    kept = estimate(selection=ScanSelection(limit=6))
    assert (kept.accuracy, kept.withheld) == (None, {"mixed-sensors": 1})
    assert read_run(out)[0].expected_accuracy().accuracy is None
    # Without its results the warning concerns nothing in the folder.
    (odd,) = out.glob("sequences/*/predictions/01.label")
    odd.unlink()
    assert estimate(options=RunOptions(shard=Shard(10, 12))).accuracy is not None
    assert read_run(out)[0].expected_accuracy().accuracy is not None


def test_a_sensor_file_of_scans_of_several_sensors_is_refused_before_the_survey(mixed):
    with calls_of(run_over_scans) as surveys, pytest.raises(NoInputError) as caught:
        inspect(mixed, sensor=SMALL, fit=True)
    assert not surveys
    assert "2 sensors" in str(caught.value)
    assert caught.value.subject == str(mixed)


def test_a_fit_is_not_advised_where_it_is_refused(mixed, tmp_path):
    write_bin(tmp_path / "one/1.bin", leaning(1))
    for folder, advised in ((mixed, False), (tmp_path / "one", True)):
        warnings = {warning.code: warning for warning in inspect(folder, sensor=SMALL).warnings}
        assert ("fit=" in warnings["tilted"].hint) == advised


def test_images_of_several_sensors_need_all_sensors(mixed, network, tmp_path, caplog):
    caplog.set_level("INFO")
    project_scans(mixed, tmp_path / "out", sensor=SMALL, fit=True)
    caplog.clear()
    predict_range_images(tmp_path / "out", tmp_path / "auto", settings=network)
    assert caplog.text.count("such as mixed/") == 2
    assert "such as none" not in caplog.text
    for member in Provenance(tmp_path / "out").recorded_sensor().members:
        single = replace(network, sensor=replace(member, others=(), traits=()))
        with pytest.raises(UsageError, match="sensors"):
            predict_range_images(tmp_path / "out", tmp_path / "single", settings=single)


def test_inspect_writes_the_sensor_that_predict_fits(mixed, tmp_path, narrow_default):
    """Labels with and without it have the same bytes."""
    folder, file = tmp_path / "leaning", tmp_path / "s.toml"
    for stem in "13":
        write_bin(folder / f"{stem}.bin", read_scan(mixed / f"{stem}.bin"))
    called("inspect", folder, "--fit", file)
    outs = [tmp_path / "auto", tmp_path / "file"]
    for out, more in zip(outs, ([], ["--sensor", file]), strict=True):
        line = ("predict", folder, out, "--engine", "torch", "--json", *more)
        found = only_json(called(*line))["sensor"]
        assert np.dot(found["up"], LEANING[2]) > 0.99
    one, other = map(labels_below, outs)
    assert one == other


def test_inspect_judges_scans_by_the_sensor_that_predict_fits(mixed, tmp_path, narrow_default):
    """Without --sensor; a sensor that is named is taken as it is."""
    out = tmp_path / "out"
    predicted = only_json(called("predict", mixed, out, "--engine", "torch", "--json"))
    inspected = only_json(called("inspect", mixed, "--json"))
    recorded = Provenance(out).recorded_sensor()
    assert len(recorded.members) == 2
    for key in ("fov_up", "fov_down", "height", "width", "up"):
        assert inspected["sensor"].get(key) == predicted["sensor"].get(key)
    # Of labels, and of weights that do not state the intensity of their training
    others = {"one-class", "low-confidence", "intensity-scale"}
    codes = {warning["code"] for warning in predicted["warnings"]} - others
    assert {warning["code"] for warning in inspected["warnings"]} == codes
    named = only_json(called("inspect", mixed, "--sensor", "hdl64", "--json"))
    assert (named["sensor"]["name"], named["sensor"]["width"]) == ("hdl64", 2048)
    assert "tilted" in {warning["code"] for warning in named["warnings"]}


def test_points_on_the_vehicle_are_not_invalid(tmp_path, narrow_default):
    scan = make_scan(4000)
    scan.points[:300] *= 0.5 / np.linalg.norm(scan.points[:300], axis=1, keepdims=True)
    scan.points[-7:] = 0
    write_bin(tmp_path / "scans/0.bin", scan)
    total = only_json(called("inspect", tmp_path / "scans", "--json"))["total"]
    assert total["invalid_points"] == 7


def test_images_unlike_training_are_named(tmp_path, narrow_default):
    """As of a file that `inspect --fit --height 8` wrote for weights to be trained."""
    write_bin(tmp_path / "one/0.bin", level(0))
    for height, is_named in ((8, True), (SMALL.height, False)):
        file, out = tmp_path / f"{height}.toml", tmp_path / f"out-{height}"
        file.write_text(replace(SMALL, height=height).to_toml())
        line = ["predict", str(tmp_path / "one"), str(out), "--engine", "torch"]
        result = called(*line, "--sensor", file)
        assert ("(other-images)" in result.stderr) == is_named
