# SPDX-License-Identifier: MIT
"""LAS clouds of labelled scans, opened again by laspy."""

import json

import numpy as np
import pytest
import yaml
from bags import messages, structured, write_bag
from command_line import called
from e57_files import Station, write_e57
from las_files import write_las
from scans import files_below, make_scan, refused, write_sequence, write_weights

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages.export_las import export_las
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import FormatError, NoInputError, OutputError
from salsanext_cli.io.frames import FRAMES, encode_frames
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

laspy = pytest.importorskip("laspy")
SPACE = label_space()
COARSE = label_space("coarse")


CODES_OF_USER = {0: 1, 2: 65, 7: 66}


@pytest.fixture
def weights_of_user(tmp_path):
    """Return weights for classes whose raw ids are codes of the ASPRS for something else."""
    space = LabelSpace.from_dict(
        {
            "name": "mine",
            "labels": {0: "none", 2: "car", 7: "person", 900: "street"},
            "learning_map": {0: 0, 2: 1, 7: 2, 900: 3},
            "learning_map_inv": {0: 0, 1: 2, 2: 7, 3: 900},
            "asprs": CODES_OF_USER,
        }
    )
    return write_weights(tmp_path / "mine.safetensors", space=space)


def cloud(world, folder="las", stem="000000"):
    return laspy.read(world.result(folder, "08", stem))


def test_every_value_is_a_dimension_and_the_classification_has_codes(predicted):
    assert export_las(predicted.out).done == 3
    las = cloud(predicted)
    labels = predicted.labels()
    np.testing.assert_array_equal(las["label"], labels & 0xFFFF)
    codes = SPACE.asprs_codes
    np.testing.assert_array_equal(las.classification, [codes[i] for i in labels.tolist()])
    extra = set(las.point_format.extra_dimension_names)
    assert extra == {"label", "truth", "wrong", "range", "least_confidence"}


def test_a_second_run_does_nothing_until_the_labels_change(predicted):
    export_las(predicted.out)
    before = files_below(predicted.out)
    assert export_las(predicted.out).skipped == 3
    assert files_below(predicted.out) == before
    export_las(predicted.out, compressed=True)
    assert cloud(predicted, "laz").header.are_points_compressed
    np.testing.assert_array_equal(
        cloud(predicted, "laz").classification, cloud(predicted).classification
    )
    las = predicted.result("las")
    las.write_bytes(b"mine")
    outcome = export_las(predicted.out, options=RunOptions(overwrite=True))
    assert [failure.code for failure in outcome.failures] == [OutputError.code]
    assert las.read_bytes() == b"mine"


def test_merged_classes_have_their_codes(predicted):
    export_las(predicted.out, query=ResultQuery(classes=COARSE))
    labels = COARSE.to_raw(COARSE.to_train(predicted.labels()))
    codes = COARSE.asprs_codes
    np.testing.assert_array_equal(
        cloud(predicted).classification, [codes[i] for i in labels.tolist()]
    )


def test_las_scans_in_a_map_keep_their_coordinates(tmp_path, world):
    points = make_scan(1500).points + np.array([500_123.4, 5_400_456.7, 312.0])
    path = write_las(tmp_path / "drive/000000.laz", points, offsets=(5e5, 5.4e6, 0), kind=1)
    out = tmp_path / "results"
    assert predict_scans(path.parent, out, settings=world.network).failures == ()
    assert export_las(out).done == 1
    las = laspy.read(out / "sequences/drive/las/000000.las")
    own = laspy.read(path)
    for name in "XYZ":
        np.testing.assert_array_equal(las[name], own[name])
    np.testing.assert_array_equal(
        las["label"], read_labels(out / "sequences/drive/predictions/000000.label")
    )


def test_scans_that_were_moved_out_of_a_map_are_written_in_it(predicted):
    frame = (690_000.0, 5_330_000.0, 0.0)
    path = predicted.scan().parent.with_name(FRAMES)
    path.write_bytes(encode_frames({"000000": frame}))
    export_las(predicted.out)
    in_map = read_scan(predicted.scan()).points + np.array(frame)
    np.testing.assert_allclose(cloud(predicted).xyz, in_map, atol=1e-4, rtol=0)
    np.testing.assert_array_equal(cloud(predicted, stem="000001").header.offsets, 0)


def test_clouds_without_a_frame_are_written_again_once_it_is_known(predicted):
    export_las(predicted.out)
    path = predicted.scan().parent.with_name(FRAMES)
    for x in (690_000.0, 680_000.0):
        path.write_bytes(encode_frames({"000000": (x, 5_330_000.0, 0.0)}))
        assert export_las(predicted.out).done == 3
        np.testing.assert_allclose(cloud(predicted).header.offsets, [x, 5_330_000, 0])
    assert export_las(predicted.out, query=ResultQuery(selection=ScanSelection(limit=1))).done == 0
    before = files_below(predicted.out)
    for content in ('{"000000": [690000, 5330000, NaN]}', "[]"):
        path.write_text(content)
        refused(FormatError, path, export_las, predicted.out)
        assert files_below(predicted.out) == before


def test_picked_scans_without_their_frames_are_refused(predicted):
    """Their points are local, and belong into a map."""
    record = predicted.data / "pick.json"
    frame = (690_000.0, 5_330_000.0, 0.0)
    recorded = {"08/000000": {"origin": frame, "is_beside": True}, "08/000001": None}
    record.write_text(json.dumps({"stage": "pick", "frames": recorded}))
    path = predicted.scan().parent.with_name(FRAMES)
    for content in (None, "{}", "[]", '{"000001": [1, 2, 3]}'):
        if content is not None:
            path.write_text(content)
        caught = refused(FormatError, path, export_las, predicted.out)
        assert "`pick` again" in caught.value.hint
    path.write_bytes(encode_frames({"000000": frame}))
    assert export_las(predicted.out).done == 3
    path.unlink()
    before = files_below(predicted.out)
    refused(FormatError, path, export_las, predicted.out)
    assert files_below(predicted.out) == before, "earlier clouds stay"
    path.write_bytes(encode_frames({"000000": frame}))
    assert export_las(predicted.out).done == 0
    local = read_scan(predicted.scan()).points
    np.testing.assert_allclose(cloud(predicted).xyz, local + np.array(frame), atol=1e-4, rtol=0)
    path.unlink()
    for content in ("[]", "no record", '{"frames": 3}', '{"stage": "pick"}'):  # Also of others
        record.write_text(content)
        export_las(predicted.out, options=RunOptions(overwrite=True))
        np.testing.assert_allclose(cloud(predicted).xyz, local, atol=1e-4, rtol=0)


def test_sequences_are_exported_although_another_one_has_lost_its_frames(predicted):
    frame = {"origin": [690_000, 5_330_000, 0], "is_beside": True}
    record = {"stage": "pick", "frames": {"08/000001": frame}}
    (predicted.data / "pick.json").write_text(json.dumps(record))
    first = ResultQuery(selection=ScanSelection(sequences=("00",)))
    assert export_las(predicted.out, query=first).done == 1
    second = ResultQuery(selection=ScanSelection(sequences=("08",)))
    lost = predicted.scan().parent.with_name(FRAMES)
    refused(FormatError, lost, export_las, predicted.out, query=second)


def test_a_file_of_another_program_does_not_make_clouds_outdated(predicted):
    export_las(predicted.out)
    predicted.scan().parent.with_name(FRAMES).write_text("[]")
    assert export_las(predicted.out).done == 0


def test_a_scan_that_is_gone_is_named_once(predicted, caplog):
    predicted.scan().unlink()
    assert export_las(predicted.out).done == 2
    assert caplog.text.count("1 scan with results skipped") == 1


def codes_of(labels, codes):
    return [codes.get(raw, 1) for raw in (labels & 0xFFFF).tolist()]


def test_a_label_space_states_the_codes(predicted, tmp_path):
    file = tmp_path / "mine.yaml"
    stated = {raw: 100 + train_id for raw, train_id in SPACE.learning_map.items() if train_id}
    file.write_text(yaml.safe_dump({**SPACE.to_dict(), "name": "mine", "asprs": stated}))
    for option in ("--label-space", "--classes"):
        called("export-las", predicted.out, option, file, "--overwrite")
        np.testing.assert_array_equal(
            cloud(predicted).classification, codes_of(predicted.labels(), stated)
        )


def test_classes_without_a_code_are_unassigned_and_a_warning_names_them(
    tmp_path, weights_of_user, caplog
):
    write_sequence(tmp_path / "data/sequences/00", ["000000"], labels=False)
    out = tmp_path / "out"
    network = NetworkSettings(weights_of_user, "cpu", engine="torch")
    assert predict_scans(tmp_path / "data", out, settings=network).done == 1
    assert export_las(out).done == 1
    labels = read_labels(out / "sequences/00/predictions/000000.label")
    las = laspy.read(out / "sequences/00/las/000000.las")
    np.testing.assert_array_equal(las.classification, codes_of(labels, CODES_OF_USER))
    assert {*labels.tolist()} >= {2, 900}, "the test needs both classes"
    assert ("street" in caplog.text, "person" in caplog.text) == (True, False)


def test_scans_of_a_site_become_clouds_in_the_frames_of_their_sensors(tmp_path, world):
    pytest.importorskip("pye57")
    scans = [make_scan(1500, seed) for seed in range(2)]
    places = [(500_000 + 5 * n, 5.4e6, 312) for n in range(2)]
    stations = [
        Station(scan.points.astype(np.float64), scan.intensity, 0.3, place)
        for scan, place in zip(scans, places, strict=True)
    ]
    assert_recording_is_exported(write_e57(tmp_path / "drive.e57", stations), scans, world)


def test_clouds_of_a_bag_become_las_clouds(tmp_path, world):
    pytest.importorskip("rosbags")
    written = [structured(1500, seed=seed) for seed in range(2)]
    bag = write_bag(tmp_path, ".bag", messages(written))
    scans = [read_scan(file.path) for file in find_scans(bag)]
    assert_recording_is_exported(bag, scans, world)


def assert_recording_is_exported(recording, scans, world):
    """Compare the points and codes of LAS clouds with the scans of a recording and its labels."""
    assert predict_scans(recording, world.out, settings=world.network).failures == ()
    assert export_las(world.out).done == len(scans)
    files = find_scans(recording)
    for file, scan in zip(files, scans, strict=True):
        las = laspy.read(world.result("las", file.sequence, file.stem))
        labels = read_labels(world.result("predictions", file.sequence, file.stem))
        np.testing.assert_allclose(las.xyz, scan.points, atol=1e-4)
        np.testing.assert_array_equal(las.classification, codes_of(labels, SPACE.asprs_codes))


def test_scans_without_labels_are_refused(tmp_path, world):
    with refused(NoInputError, world.out):
        export_las(world.out)
    world.predict()
    world.result("predictions").unlink()
    outcome = export_las(world.out)
    assert (outcome.done, len(outcome.missing.scans)) == (2, 1)
    write_labels(world.result("predictions"), np.zeros(3, np.uint32))
    outcome = export_las(world.out, options=RunOptions(overwrite=True))
    assert len(outcome.failures) == 1
