# SPDX-License-Identifier: MIT
"""Labels of scans: in one step or three, one by one or in batches; projections."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from command_line import python
from scans import (
    SMALL,
    files_below,
    labels_below,
    make_scan,
    refused,
    replace_points,
    write_bin,
    write_sequence,
    write_weights,
)

from salsanext_cli import KnnParameters, LabelSpace, knn_refine, label_space, project, read_scan
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.records import Scan
from salsanext_cli.io.formats.ply import write_ply
from salsanext_cli.io.sensors import sensor
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.runs.fit.range_images import projected_sensor
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings


def run(world, source=None, **options):
    return predict_scans(source or world.data, world.out, settings=world.network, **options)


def test_the_labels_are_those_of_the_three_steps(on_openvino):
    world = on_openvino
    assert run(world).done == 3
    network = world.network.load()
    image = project(read_scan(world.scan("08", "000001")), SMALL)
    pixels = network.probabilities(image).argmax(axis=0)
    expected = label_space().to_raw(knn_refine(image, pixels))
    labels = world.labels("08", "000001")
    np.testing.assert_array_equal(labels, expected)
    assert len(np.unique(labels)) > 3
    assert not (labels >> 16).any()
    # Two sequences have a scan of that name.
    assert (world.labels("00") != world.labels("08")).any()


def test_extras_agree_with_the_labels(world):
    run(world, extras=("pixel_labels", "probabilities"))
    pixels = np.load(world.result("pixel_labels"))
    probabilities = np.load(world.result("probabilities"))
    assert pixels.dtype == np.uint8
    assert pixels.shape == (16, 128)
    assert probabilities.dtype == np.float16
    assert probabilities.shape == (1500, 20)
    np.testing.assert_allclose(probabilities.sum(axis=1, dtype=np.float32), 1, atol=5e-3)
    image = project(read_scan(world.scan()), SMALL)
    of_points = pixels.ravel()[image.pixel_of_point]
    assert (probabilities.argmax(axis=1) == of_points).mean() > 0.99
    least = np.load(world.result("uncertainty/least_confidence"))
    assert (least.dtype, least.shape) == (np.float32, (1500,))
    np.testing.assert_allclose(least, 1 - probabilities.max(axis=1), atol=1e-3)


def test_complete_results_are_skipped_and_missing_ones_made_again(world):
    run(world)
    before = files_below(world.out)
    world.result("predictions").unlink()
    world.result("predictions", "00").write_bytes(b"")
    outcome = run(world)
    assert (outcome.done, outcome.skipped) == (2, 1)
    assert files_below(world.out) == before
    # Extras can be asked for later.
    outcome = run(world, extras=("probabilities",))
    assert (outcome.done, outcome.skipped) == (3, 0)


def test_a_plain_folder_and_several_formats(world, tmp_path):
    folder = tmp_path / "my drive"
    scan = make_scan(seed=4)
    columns = dict(zip("xyz", scan.points.T, strict=True)) | {"intensity": scan.intensity}
    write_bin(folder / "scan 1.bin", scan)
    write_ply(folder / "Fahrt ü.ply", columns)
    assert run(world, folder).done == 2
    assert labels_below(world.out).keys() == {
        "sequences/my drive/predictions/scan 1.label",
        "sequences/my drive/predictions/Fahrt ü.label",
    }
    one, two = labels_below(world.out).values()
    assert one == two


NAN, INF = float("nan"), float("inf")
ODD_POINTS = [(0, 0, 0), (NAN, 1, 1), (1, INF, 1), (-INF, 0, 0), (NAN, NAN, NAN)]


@pytest.mark.parametrize("points", [[], [(0, 0, 0)], ODD_POINTS])
def test_scans_without_a_measurement_fail(world, points):
    scan = replace_points(world.scan(), points)
    outcome = run(world, scan)
    assert outcome.done == 0
    assert [failure.code for failure in outcome.failures] == ["format"]
    assert not world.result("predictions").exists()


@pytest.mark.parametrize("points", [[(1, 0, 0)], [*ODD_POINTS, (5, 0, 0)]])
def test_odd_scans(world, points):
    scan = replace_points(world.scan(), points)
    outcome = run(world, scan, extras=("probabilities",))
    assert outcome.done == 1
    labels = world.labels()
    assert len(labels) == len(points)
    nowhere = np.array([not np.isfinite(p).all() or not any(p) for p in points], bool)
    least = np.load(world.result("uncertainty/least_confidence"))
    np.testing.assert_array_equal(np.isnan(least), nowhere)
    assert not labels[nowhere].any()
    probabilities = np.load(world.result("probabilities"))
    assert probabilities.shape == (len(points), 20)
    assert (probabilities[nowhere] == np.eye(1, 20)).all()
    assert np.isfinite(probabilities).all()


def test_files_that_cannot_be_read_are_named_and_the_rest_is_done(world):
    folder = world.scan().parent
    shutil.rmtree(folder)
    write_sequence(folder.parent, ["good"])
    (folder / "cut.bin").write_bytes(b"\0" * 30)
    (folder / "gone.bin").symlink_to(folder / "nowhere.bin")
    (folder / "text.ply").write_text("no ply at all")
    outcome = run(world, folder)
    assert outcome.done == 1
    assert [failure.scan.stem for failure in outcome.failures] == ["cut", "gone", "text"]
    for failure in outcome.failures:
        assert str(failure.scan.path) in failure.reason
    again = run(world, folder)
    assert (again.done, again.skipped, len(again.failures)) == (0, 1, 3)


def test_weights_of_another_label_space_write_its_raw_ids(world, tmp_path):
    two = {"name": "two", "labels": {7: "nothing", 500: "thing"}}
    two |= {"learning_map": {7: 0, 500: 1}, "learning_map_inv": {0: 7, 1: 500}}
    weights = write_weights(tmp_path / "two.safetensors", space=LabelSpace.from_dict(two))
    predict_scans(world.data, world.out, settings=NetworkSettings(weights, "cpu", engine="torch"))
    assert set(np.unique(world.labels())) <= {7, 500}


NOT_BY_16 = replace(SMALL, height=13, width=90, fov_up=-2.0, fov_down=-20.0, out_of_view="drop")


def test_in_three_steps_or_in_one_gives_the_same_bytes(on_openvino, tmp_path):
    world = on_openvino
    replace_points(world.scan("00"), [*ODD_POINTS, (5, 0, 0)])
    network = replace(world.network, sensor=NOT_BY_16)
    images = tmp_path / "projected"
    project_scans(world.data, images, sensor=NOT_BY_16)
    assert predict_range_images(images, world.out, settings=network).done == 3
    assert np.load(world.result("pixel_labels")).dtype == np.uint8
    assert not labels_below(world.out)
    assert knn_refine_scans(world.out).done == 3
    predict_scans(world.data, tmp_path / "fused", settings=network)
    assert labels_below(world.out) == labels_below(tmp_path / "fused")
    assert len(labels_below(world.out)) == 3


def test_range_images_of_another_sensor_are_refused_and_damaged_ones_named(world, tmp_path):
    project_scans(world.data, tmp_path / "p", sensor=SMALL.resized(width=64))
    with pytest.raises(UsageError) as caught:
        predict_range_images(tmp_path / "p", world.out, settings=world.network)
    assert "64" in caught.value.problem
    assert "128" in caught.value.problem + caught.value.expected
    project_scans(world.data, world.out, sensor=SMALL)
    path = world.result("range")
    path.write_bytes(path.read_bytes()[:-1])
    outcome = predict_range_images(world.out, world.out, settings=world.network)
    assert outcome.done == 2
    assert str(path) in outcome.failures[0].reason


def test_a_label_corrected_by_hand_is_never_replaced(world):
    """The scan is named as a failure; the others are made again."""
    run(world)
    path = world.result("predictions")
    path.write_bytes(b"\x28\0\0\0" * 1500)
    outcome = run(world, options=RunOptions(overwrite=True), knn=KnnParameters(k=3))
    assert outcome.done == 2
    (failure,) = outcome.failures
    assert str(path) in failure.reason
    assert path.read_bytes() == b"\x28\0\0\0" * 1500


def test_logits_that_are_not_finite_are_an_error_of_weights_and_scan(world, tmp_path):
    """Weights may be finite and absurd."""
    module, card = read_weights(world.network.weights)
    with torch.no_grad():
        module.logits.weight *= 1e38
    save_weights(tmp_path / "absurd.safetensors", module, card)
    network = replace(world.network, weights=tmp_path / "absurd.safetensors")
    for batch in (None, 2):
        outcome = predict_scans(world.data, world.out, settings=network, batch=batch)
        assert outcome.done == 0
        for failure in outcome.failures:
            assert failure.code == "weights"
            assert "absurd.safetensors" in failure.reason
            assert str(failure.scan.path) in failure.reason
    assert not labels_below(world.out)


def test_objects_need_movable_classes(world):
    silent = LabelSpace.from_dict(label_space().to_dict() | {"movable": []})
    settings = replace(world.network, classes=silent)
    with refused(UsageError, 'extras=("objects",)'):
        predict_scans(world.data, world.out, settings=settings, extras=("objects",))
    assert not world.out.exists()


def test_objects_are_numbered_in_the_upper_bits_and_have_a_row_each(world):
    run(world)
    plain = world.labels()
    with pytest.raises(OutputError):
        run(world, extras=("objects",))
    run(world, extras=("objects",), options=RunOptions(overwrite=True))
    raw = world.labels()
    np.testing.assert_array_equal(raw & 0xFFFF, plain)
    header, *lines = world.result("objects").read_text().splitlines()
    assert header == "object,class,points,x,y,z,length,width,height,yaw"
    rows = [line.split(",") for line in lines]
    assert [int(row[0]) for row in rows] == list(range(1, int((raw >> 16).max()) + 1))
    space, points = label_space(), read_scan(world.scan()).points
    for number, name, count, *box in rows:
        own = raw >> 16 == int(number)
        assert own.sum() == int(count) >= 10
        assert {space.names[train] for train in space.to_train(raw[own])} == {name}
        place, size = np.float64(box[:3]), np.float64(box[3:6])
        assert (np.linalg.norm(points[own] - place, axis=1) <= np.linalg.norm(size)).all()


def test_several_sources_are_one_run(world):
    sources = [world.scan("08", "000001"), world.data / "sequences/00", world.scan("08", "000001")]
    assert run(world, sources).done == 2
    assert world.labels("08", "000001").any()
    twice = world.data / "other/sequences/08/velodyne/000001.bin"
    twice.parent.mkdir(parents=True)
    shutil.copy(world.scan("08", "000001"), twice)
    refused(OutputError, "08/000001", run, world, [twice, world.scan("08", "000001")])


EXTRAS = ("pixel_labels", "probabilities")


def bytes_below(folder):
    found = files_below(folder).items()
    return {name: data for name, data in found if name.endswith((".label", ".npy"))}


@pytest.fixture
def nine(on_openvino):
    """Return a world with a sequence of nine scans, of two points, of one and of many."""
    world = on_openvino
    folder = world.data / "sequences" / "05"
    write_sequence(folder, [f"{n:06d}" for n in range(8)], labels=False)
    replace_points(folder / "velodyne" / "000007.bin", [(NAN, 1, 1), (6, 2, 0)])
    write_bin(folder / "velodyne" / "000008.bin", Scan(np.float32([[5, 1, 0]]), np.float32([0.5])))
    return world


def predict(world, out, **options):
    return predict_scans(world.data / "sequences/05", out, **{"settings": world.network, **options})


def test_the_same_bytes_in_batches_of_any_size(nine, tmp_path):
    predict(nine, tmp_path / "1", extras=EXTRAS)
    expected = bytes_below(tmp_path / "1")
    assert len(expected) == 4 * 9
    outcome = predict(nine, tmp_path / "4", extras=EXTRAS, batch=4)
    assert (outcome.done, outcome.failures) == (9, ())
    assert bytes_below(tmp_path / "4") == expected


def test_scans_that_fail_do_not_keep_the_others(nine, tmp_path):
    """They cannot be read, or their results cannot be written."""
    (nine.data / "sequences/05/velodyne/000003.bin").write_bytes(b"cut off")
    blocked = tmp_path / "out/sequences/05/predictions/000002.label"
    blocked.mkdir(parents=True)
    outcome = predict(nine, tmp_path / "out", batch=4, options=RunOptions(overwrite=True))
    assert [failure.scan.stem for failure in outcome.failures] == ["000002", "000003"]
    assert outcome.done == 7


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


def test_the_stage_imports_no_part_that_labelling_does_not_need():
    done = python("import sys, salsanext_cli.commands.stages.predict; print(*sys.modules)")
    names = done.stdout.split()
    own = {name.split(".")[1] for name in names if name.startswith("salsanext_cli.")}
    others = {"cli", "fusion", "labelling", "report", "synthesis", "training"}
    assert own & others == set()
    assert {"matplotlib", "open3d", "plyfile", "torch"} & {*names} == set()


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
    assert caplog.text.count("outside the field of view") == (0 if fits else 1)
