# SPDX-License-Identifier: MIT
"""Recordings as input of the stages, and as folders of scans."""

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import START, STEP, messages, structured, write_bag
from scans import files_below, labels_below, refused

from salsanext_cli import read_scan
from salsanext_cli.commands.stages.convert import convert
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import NoInputError, OutputError, UsageError
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans

POINTS = [structured(seed=seed) for seed in range(5)]
TIMES = [f"{START + n * STEP}" for n in range(5)]
SECONDS = [f"{n / 10:.9f}" for n in range(5)]


@pytest.fixture
def bag(tmp_path):
    return write_bag(tmp_path, ".bag", messages(POINTS))


def sequence(folder):
    """Return the names of the scans of a converted recording, and the times listed."""
    place = folder / "sequences/drive"
    times = (place / "times.txt").read_text().split()
    return sorted(path.name for path in (place / "velodyne").iterdir()), times


def test_a_recording_becomes_a_sequence_of_the_same_scans(bag, tmp_path):
    folder = tmp_path / "data"
    assert convert(bag, folder).done == 5
    assert sequence(folder) == ([f"{time}.bin" for time in TIMES], SECONDS)
    for inside, outside in zip(find_scans(bag), find_scans(folder), strict=True):
        assert (inside.sequence, inside.stem) == (outside.sequence, outside.stem)
        expected, found = read_scan(inside.path), read_scan(outside.path)
        np.testing.assert_array_equal(found.points, expected.points)
        np.testing.assert_array_equal(found.intensity, expected.intensity)


def test_clouds_without_points_or_measurements_fail_and_the_others_are_labelled(tmp_path, weights):
    unmeasured = structured(50)
    for axis in "xyz":
        unmeasured[axis] = np.nan
    written = [structured(0), unmeasured, POINTS[2]]
    bag = write_bag(tmp_path, ".bag", messages(written))
    network = NetworkSettings(weights, "cpu", engine="torch")
    outcome = predict_scans(bag, tmp_path / "out", settings=network)
    assert [failure.scan.stem for failure in outcome.failures] == TIMES[:2]
    assert {failure.code for failure in outcome.failures} == {"format"}
    assert outcome.done == 1


@pytest.mark.usefixtures("workers_in_process")
def test_scans_that_the_file_system_does_not_show_yet_have_times(bag, tmp_path, monkeypatch):
    """A network file system may hide for a while what a worker on another machine has written."""
    monkeypatch.setattr("salsanext_cli.commands.stages.convert.filled", lambda path: False)
    convert(bag, tmp_path / "data", limit=2)
    assert sequence(tmp_path / "data")[1] == SECONDS[:2]


def test_some_of_the_scans_and_later_the_rest(bag, tmp_path):
    folder = tmp_path / "data"
    assert convert(bag, folder, every=3).done == 2
    assert sequence(folder) == ([f"{TIMES[0]}.bin", f"{TIMES[3]}.bin"], ["0.000000000", SECONDS[3]])
    assert convert(bag, folder, every=2, limit=2).done == 1
    before = files_below(folder)
    outcome = convert(bag, folder, options=RunOptions(jobs=2))
    assert (outcome.done, outcome.skipped) == (2, 3)
    assert sequence(folder) == ([f"{time}.bin" for time in TIMES], SECONDS)
    after = files_below(folder)
    del before["sequences/drive/times.txt"]
    assert before.items() <= after.items()


def test_nothing_else_is_replaced(bag, tmp_path):
    folder = tmp_path / "data"
    place = folder / "sequences/drive"
    convert(bag, folder, limit=2)
    for path, content in (
        (place / "velodyne" / f"{TIMES[0]}.bin", b"mine"),
        (place / "velodyne/000000.bin", b"mine"),
        (place / "times.txt", b"mine"),
    ):
        before = path.read_bytes() if path.exists() else None
        path.write_bytes(content)
        with pytest.raises(OutputError, match=path.name):
            convert(bag, folder, options=RunOptions(overwrite=True))
        assert path.read_bytes() == content
        path.unlink()
        if before is not None:
            convert(bag, folder, limit=2)


def test_another_topic_or_recording_of_that_name_needs_another_folder(bag, tmp_path):
    folder = tmp_path / "data"
    written = [*messages(POINTS, "/front"), *messages(POINTS[::-1], "/rear")]
    other = write_bag(tmp_path / "other", ".bag", written)
    convert(other / "front", folder)
    before = files_below(folder)
    for source in (other / "rear", bag):
        with pytest.raises(OutputError) as caught:
            convert(source, folder, options=RunOptions(overwrite=True))
        assert caught.value.hint == "choose another folder"
    assert files_below(folder) == before
    moved = bag.with_name("moved")
    other.parent.rename(moved)
    assert convert(moved / "drive.bag/front", folder).skipped == 5


def test_a_cloud_without_points_is_skipped(world, tmp_path, caplog):
    """Its `.bin` file would be empty, like one that was cut off."""
    points = [POINTS[0], POINTS[1][:0], POINTS[2]]
    path, folder = write_bag(tmp_path, ".mcap", messages(points)), tmp_path / "data"
    for done, jobs in ((2, 1), (0, 2)):
        outcome = convert(path, folder, options=RunOptions(jobs=jobs))
        assert (outcome.done, outcome.skipped, outcome.failures) == (done, 2 - done, ())
        assert TIMES[1] in caplog.text
        caplog.clear()
    assert sequence(folder) == ([f"{TIMES[0]}.bin", f"{TIMES[2]}.bin"], [SECONDS[0], SECONDS[2]])
    assert predict_scans(folder, tmp_path / "out", settings=world.network).done == 2


def test_only_recordings_are_converted(bag, tmp_path):
    for given in ({"every": 0}, {"limit": 0}):
        with pytest.raises(UsageError, match="at least 1"):
            convert(bag, tmp_path / "data", **given)
    for path in (tmp_path, tmp_path / "no.bag"):
        with pytest.raises(UsageError, match="recording"):
            convert(path, tmp_path / "data")


def test_stages_take_a_recording_and_find_it_again(world, bag, tmp_path):
    out, folder = tmp_path / "out", tmp_path / "data"
    assert predict_scans(bag, out, settings=world.network).done == 5
    convert(bag, folder)
    predict_scans(folder, tmp_path / "ref", settings=world.network)
    assert labels_below(out) == labels_below(tmp_path / "ref")
    assert ResultFolder(out).scans() == find_scans(bag)
    assert export_ply(out).done == 5
    moved = bag.rename(tmp_path / "moved.bag")
    with pytest.raises(NoInputError, match=r"drive\.bag"):
        ResultFolder(out).scans()
    found = ResultFolder(out, moved).scans()
    assert {(scan.sequence, scan.path.parents[1]) for scan in found} == {("drive", moved)}


def test_a_recording_is_not_converted_into_a_folder_of_other_scans(bag, tmp_path):
    """They would be hidden."""
    folder = tmp_path / "scans"
    convert(bag, tmp_path / "data", limit=1)
    (tmp_path / "data/sequences/drive/velodyne").rename(folder)
    before = files_below(folder)
    refused(OutputError, folder, convert, bag, folder)
    assert files_below(folder) == before
