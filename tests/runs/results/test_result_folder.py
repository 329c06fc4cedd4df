# SPDX-License-Identifier: MIT
"""Results and their scans: located, read, refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scans import SMALL, make_scan, refused, replace_points, write_array, write_bin, write_sequence
from world import begin_and_end

from salsanext_cli import Scan, label_space
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.core.errors import FormatError, LabelError, NoInputError, OutputError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.formats.kitti_labels import write_labels
from salsanext_cli.io.formats.ply import write_ply
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import ScanResults, scalar_columns
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection


def ask(world, scans):
    """Write the record that `predict` writes before its first scan."""
    begin_and_end(world.out, "predict", {}, ["predictions"], scans)


def names(results):
    return [f"{scan.sequence}/{scan.stem}" for scan in results.scans], results.not_asked_for


def test_scans_are_in_the_recorded_or_the_given_data_set(world):
    scans = find_scans(world.data)
    ask(world, scans)
    world.predict_by_hand()
    assert ResultFolder(world.out).scans() == scans
    moved = world.data.rename(world.data.with_name("moved"))
    for dataset in (None, world.out.with_name("nowhere")):
        with refused(NoInputError, world.out / "sequences/00"):
            ResultFolder(world.out, dataset).scans()
    assert ResultFolder(world.out, moved).scans() == find_scans(moved)


def test_scans_that_were_replaced_by_files_of_another_format_are_not_those_of_the_results(world):
    ask(world, find_scans(world.data))
    world.predict_by_hand()
    for scan in find_scans(world.data):
        replace_points(scan.path, make_scan().points)
    folder = ResultFolder(world.out)
    with refused(NoInputError, world.out / "sequences/00"):
        folder.predicted(ScanSelection(split="valid"))


def test_scans_of_one_sequence_may_move_under_another_name(world, tmp_path):
    drive, place = write_sequence(tmp_path / "drive"), "velodyne"
    predict_scans(drive / place, world.out, settings=world.network)
    moved = drive.rename(tmp_path / "moved")
    with refused(NoInputError, world.out / "sequences/drive"):
        ResultFolder(world.out).scans()
    (scan,) = ResultFolder(world.out, moved / place).scans()
    assert (scan.sequence, scan.stem) == ("drive", "000000")
    assert scan.path == moved / "velodyne/000000.bin"
    assert scan.label_path == moved / "labels/000000.label"


def test_recorded_scans_are_not_looked_for_in_the_current_folder(world, monkeypatch):
    """Scans of another data set have the same names."""
    ask(world, find_scans(world.data))
    world.predict_by_hand()
    moved = world.data.rename(world.data.with_name("moved"))
    monkeypatch.chdir(moved)
    monkeypatch.setenv("SALSANEXT_DATASET", "")
    with refused(NoInputError, world.out / "sequences/00") as caught:
        ResultFolder(world.out).scans()
    assert str(world.data) in caught.value.problem
    assert "dataset" in caught.value.hint
    monkeypatch.setenv("SALSANEXT_DATASET", str(moved))
    assert ResultFolder(world.out).scans() == find_scans(moved)


def test_scans_are_found_beside_results_that_were_moved_together_with_them(world, monkeypatch):
    ask(replace(world, out=world.data), find_scans(world.data))
    replace(world, out=world.data).predict_by_hand()
    monkeypatch.delenv("SALSANEXT_DATASET", raising=False)
    moved = world.data.rename(world.data.with_name("moved"))
    assert ResultFolder(moved).scans() == find_scans(moved)
    nowhere = moved.with_name("nowhere")
    caught = refused(NoInputError, moved / "sequences/00", ResultFolder(moved, nowhere).scans)
    assert str(nowhere) in caught.value.problem
    (moved / "predict.json").unlink()
    caught = refused(NoInputError, moved, ResultFolder(moved).scans)
    assert "is a data set" in caught.value.problem
    monkeypatch.chdir(moved)
    assert ResultFolder(Path()).scans() == find_scans(moved)


def test_scans_of_unrecorded_results_are_in_the_working_directory(world, monkeypatch):
    world.predict_by_hand()
    with refused(NoInputError, world.out / "sequences/00"):
        ResultFolder(world.out).scans()
    monkeypatch.setenv("SALSANEXT_DATASET", str(world.data))
    assert ResultFolder(world.out).scans() == find_scans(world.data)
    monkeypatch.delenv("SALSANEXT_DATASET")
    monkeypatch.chdir(world.data)
    assert ResultFolder(world.out).scans() == find_scans(world.data)
    missing = ResultFolder(world.out).missing_predictions(find_scans(world.data))
    assert names(missing) == (["00/000000", "08/000000", "08/000001"], 0)


@pytest.mark.parametrize("name", ["none", ""])
def test_an_output_folder_without_results_is_refused(tmp_path, name):
    with refused(NoInputError, tmp_path / name):
        ResultFolder(tmp_path / name).scans()


def test_results_of_scans_that_were_not_asked_for_are_not_missing(world):
    scans = find_scans(world.data)
    ask(world, scans[1:2])
    assert names(ResultFolder(world.out).missing_predictions(scans[1:])) == (["08/000000"], 1)
    assert names(ResultFolder(world.out).missing_results(scans[1:])) == (["08/000000"], 1)
    both = ["08/000000", "08/000001"]
    # Only the stage that predicts can lack predictions.
    begin_and_end(world.out, "uncertainty", {}, ["uncertainty/epistemic"], scans)
    assert names(ResultFolder(world.out).missing_predictions(scans[1:])) == (["08/000000"], 1)
    assert names(ResultFolder(world.out).missing_results(scans[1:])) == (both, 0)
    ask(world, scans[2:])
    assert names(ResultFolder(world.out).missing_predictions(scans[1:])) == (both, 0)


def test_refined_labels_are_of_the_scans_of_predict(world):
    project_scans(world.data, world.out, sensor=SMALL, selection=ScanSelection(sequences=("08",)))
    first = ScanSelection(limit=1)
    predict_range_images(world.out, world.out, settings=world.network, selection=first)
    assert knn_refine_scans(world.out).done == 1
    scans = find_scans(world.data, ["08"])
    assert names(ResultFolder(world.out).missing_predictions(scans)) == (["08/000000"], 1)


def test_folders_beside_the_scan_of_a_result_are_not_named(world, tmp_path, caplog):
    """Only the scans of the results matter, whatever else lies in their folder."""
    scan = tmp_path / "scans/0.bin"
    write_bin(scan, make_scan())
    ask(world, find_scans(scan))
    write_labels(world.out / "sequences/scans/predictions/0.label", np.zeros(1500, np.uint32))
    write_bin(tmp_path / "scans/other/velodyne/1.bin", make_scan())
    with caplog.at_level(NOTICE):
        (file,) = ResultFolder(world.out).scans()
    assert file.path == scan
    assert caplog.messages == []


def test_a_table_that_was_named_is_a_scan_beside_clouds(world, tmp_path):
    folder = write_sequence(tmp_path / "drive", labels=False) / "velodyne"
    write_array(folder / "table.npy", np.ones((5, 4)))
    write_array(folder / "other.npy", np.ones((5, 4)))
    ask(world, find_scans(folder / "table.npy"))
    write_labels(world.out / "sequences/drive/predictions/table.label", np.zeros(5, np.uint32))
    names = [scan.path.name for scan in ResultFolder(world.out).scans()]
    assert names == ["000000.bin", "table.npy"]


@pytest.mark.parametrize("suffix", [".bin", ".ply", ".npy"])
def test_the_predicted_file_is_chosen_among_files_of_its_stem(world, tmp_path, suffix):
    folder = write_sequence(tmp_path / "drive", ["a", "b"], labels=False) / "velodyne"
    for stem in "ab":
        write_ply(folder / f"{stem}.ply", dict.fromkeys("xyz", np.ones(5, np.float32)))
    write_array(folder / "a.npy", np.ones((5, 4)))
    refused(OutputError, "drive/a", find_scans, folder)
    named = find_scans(folder / f"a{suffix}")
    ask(world, named)
    write_labels(world.out / "sequences/drive/predictions/a.label", np.zeros(5, np.uint32))
    # A table among clouds is no scan of a folder that is named.
    for dataset in (None,) if suffix == ".npy" else (None, folder):
        scans = ResultFolder(world.out, dataset).scans()
        assert [scan for scan in scans if scan.stem == "a"] == named
    gone = named[0].path.rename(tmp_path / named[0].path.name)
    assert not [scan for scan in ResultFolder(world.out).scans() if scan.stem == "a"]
    gone.rename(named[0].path)
    other = find_scans(folder / ("a.ply" if suffix == ".bin" else "a.bin"))
    refused(OutputError, world.out, ask, world, other)


def test_files_of_one_stem_are_refused_if_the_record_names_none(world, tmp_path):
    folder = write_sequence(tmp_path / "drive", ["a"], labels=False) / "velodyne"
    ask(world, find_scans(folder))
    write_labels(world.out / "sequences/drive/predictions/a.label", np.zeros(5, np.uint32))
    path = world.out / "predict.json"
    path.write_text(path.read_text().replace("a.bin", "a"))  # As earlier versions recorded it
    assert [scan.path.name for scan in ResultFolder(world.out).scans()] == ["a.bin"]
    write_ply(folder / "a.ply", dict.fromkeys("xyz", np.ones(5, np.float32)))
    with refused(OutputError, "drive/a"):
        ResultFolder(world.out).scans()


SPACE = label_space()
CAR, ROAD, MOVING_CAR = 10, 40, 252


@pytest.fixture
def file(world):
    return next(scan for scan in find_scans(world.data) if scan.sequence == "08")


def test_a_scan_without_results_has_no_more_columns(world, file):
    file.label_path.unlink()
    cloud = ResultFolder(world.out).read(file)
    assert cloud.label is None
    assert cloud.truth is None
    assert cloud.uncertainty == {}
    assert set(scalar_columns(cloud, SPACE)) == {"intensity", "range"}
    with pytest.raises(ValueError, match="truth"):
        cloud.wrong(SPACE)


def test_columns_of_all_results(world, file):
    world.predict_by_hand(CAR | 3 << 16)
    for kind in ("entropy", "total"):
        write_array(world.result(f"uncertainty/{kind}"), np.linspace(0, 1, 1500, dtype=np.float32))
    cloud = ResultFolder(world.out).read(file, truth_in=(SPACE, SPACE))
    assert set(scalar_columns(cloud, SPACE)) == {
        *("intensity", "range", "label", "truth", "wrong", "instance"),
        *("entropy", "total"),
    }
    assert set(cloud.instance) == {3}
    assert set(cloud.label) == {CAR}
    np.testing.assert_allclose(cloud.range, np.sqrt((cloud.scan.points**2).sum(1)), rtol=1e-6)


def test_wrong_is_one_zero_or_nan_and_ranges_may_be_too_large_for_their_squares():
    truth = np.array([CAR, CAR, 0, MOVING_CAR, ROAD], np.uint32)
    label = np.array([CAR, ROAD, CAR, CAR, 0], np.uint32)
    wrong = ScanResults(scan=make_scan(5), label=label, truth=truth).wrong(SPACE)
    np.testing.assert_array_equal(wrong, np.float32([0, 1, np.nan, 0, 1]), strict=True)
    points = np.array([[3e30, 4e30, 0], [3e38, 3e38, 3e38], [np.nan, 0, 0]], np.float32)
    distance = ScanResults(scan=Scan(points, np.zeros(3, np.float32))).range
    np.testing.assert_allclose(distance, [5e30, np.inf, np.nan], rtol=1e-6)


def test_files_of_another_scan_are_refused(world, file):
    world.predict_by_hand(count=9)
    with refused(LabelError, world.result("predictions")):
        ResultFolder(world.out).read(file)
    world.predict_by_hand()
    write_array(world.result("uncertainty/entropy"), np.zeros(3, np.float32))
    with refused(FormatError, world.result("uncertainty/entropy")):
        ResultFolder(world.out).read(file)
    write_labels(file.label_path, np.zeros(4, np.uint32))
    with refused(LabelError, file.label_path):
        ResultFolder(world.out).read(file, truth_in=(SPACE, SPACE))
