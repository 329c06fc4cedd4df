# SPDX-License-Identifier: MIT
import json
import shutil
from functools import partial

import numpy as np
import pytest
from bags import START, TOPIC, cloud, write_bag
from evaluated import World
from scans import files_below, write_array

from salsanext_cli import label_space, read_scan, sensor, write_labels
from salsanext_cli.errors import NoInputError, OutputError, UsageError
from salsanext_cli.parallel.options import Shard
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.results.layout import output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.filter import filter_scans, named_classes

SPACE = label_space()
CAR, TRUCK, PERSON, RIDER, ROAD, TREE = 10, 18, 30, 31, 40, 70
EVERY = (CAR, TRUCK, PERSON, RIDER, ROAD, TREE, 0)


@pytest.fixture
def world(tmp_path):
    """Return two scans with predictions, of which the second is all road."""
    made = World(tmp_path)
    made.add("000000", None, EVERY)
    made.add("000001", None, [ROAD] * 4)
    return made


@pytest.fixture
def apply(world, tmp_path):
    return partial(filter_scans, world.out, tmp_path / "to", query=ResultQuery(world.dataset))


def left(tmp_path, stem="000000", folder="velodyne", suffix=".bin"):
    """Return which records of a scan are left, by their places in it."""
    source = np.fromfile(tmp_path / f"Daten 1/sequences/08/velodyne/{stem}.bin", "V16")
    found = np.fromfile(tmp_path / f"to/sequences/08/{folder}/{stem}{suffix}", "V16")
    places = [i for i, each in enumerate(source) if each in found]
    assert source[places].tobytes() == found.tobytes()
    return places


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"drop": ["person", "vehicle"]}, [3, 4, 5, 6]),
        ({"drop": ["moving"]}, [4, 5, 6]),
        ({"keep": ["vehicle"]}, [0, 1]),
        ({"keep": ["vehicle"], "drop": ["truck"]}, [0]),
        ({"keep": ["unlabeled", "vegetation"]}, [5, 6]),
    ],
)
def test_classes_are_fine_coarse_or_what_may_move(apply, tmp_path, options, expected):
    outcome = apply(**options)
    assert left(tmp_path) == expected
    assert outcome.kept_points == (11, len(expected) + 4 * ("keep" not in options))


def test_points_above_an_error_go(apply, world, tmp_path):
    world.put("uncertainty/error", "000000", [0, 0.1, 0.2, np.nan, 1, 0, 0])
    outcome = apply(max_error=0.1, drop=["car"])
    assert left(tmp_path) == [1, 3, 5, 6]
    (failure,) = outcome.failures
    assert "000001.bin · no error known" in failure.reason


def test_a_file_for_each_class(apply, tmp_path):
    apply(split=True, drop=["vehicle"])
    folders = {path.name for path in (tmp_path / "to/sequences/08").iterdir()}
    assert folders == {"person", "bicyclist", "road", "vegetation", "unlabeled"}
    assert left(tmp_path, folder="road") == [4]
    assert left(tmp_path, "000001", "road") == [0, 1, 2, 3]
    (tmp_path / "to/sequences/08/person/000000.bin").unlink()
    again = apply(split=True, drop=["vehicle"])
    assert (again.done, again.skipped) == (1, 1)
    assert left(tmp_path, folder="person") == [2]


def test_what_a_scan_has_no_more_is_removed(apply, world, tmp_path):
    apply(split=True)
    path = output_path(world.out, "08", "predictions", "000001")
    write_labels(path, np.array([CAR] * 4, np.uint32))
    apply(split=True, options=RunOptions(overwrite=True))
    assert not (tmp_path / "to/sequences/08/road/000001.bin").exists()
    assert left(tmp_path, "000001", "car") == [0, 1, 2, 3]


def test_masks_in_the_place_of_scans(apply, tmp_path):
    apply(indices=True, keep=["car"])
    masks = [np.load(tmp_path / f"to/sequences/08/masks/00000{i}.npy") for i in (0, 1)]
    assert [mask.tolist() for mask in masks] == [[True] + 6 * [False], 4 * [False]]
    assert masks[0].dtype == bool


def test_a_scan_without_any_point_left_is_said(apply, tmp_path, caplog):
    apply(drop=["road"])
    assert "no point stays of 1 scan: 08/000001" in caplog.text
    assert not (tmp_path / "to/sequences/08/velodyne/000001.bin").exists()


def test_shards_workers_and_restarts_write_the_same(apply, tmp_path):
    apply(drop=["car"])
    first = files_below(tmp_path / "to")
    shutil.rmtree(tmp_path / "to")
    for number in (1, 2):
        outcome = apply(drop=["car"], options=RunOptions(shard=Shard(number, 2), jobs=2))
        assert outcome.done == 1
    assert files_below(tmp_path / "to") == first
    assert apply(drop=["car"]).skipped == 2


def test_other_settings_are_refused_or_replace_own_files_only(apply, tmp_path):
    apply(drop=["car"])
    with pytest.raises(OutputError, match="made with other settings: classes"):
        apply(drop=["truck"])
    edited = tmp_path / "to/sequences/08/velodyne/000000.bin"
    edited.write_bytes(b"mine")
    outcome = apply(drop=["truck"], options=RunOptions(overwrite=True))
    assert "000000.bin · was changed, or not written by salsanext" in outcome.failures[0].reason
    assert edited.read_bytes() == b"mine"
    assert left(tmp_path, "000001") == [0, 1, 2, 3]


def test_results_made_anew_are_not_mixed_with_earlier_ones(apply, world):
    record = {"stage": "predict", "settings": {"label_space": SPACE.to_dict(), "batch": 1}}
    record["settings"]["sensor"] = sensor("hdl64").to_dict()
    record |= {"writes": ["predictions"], "scans": {}}
    (world.out / "predict.json").write_text(json.dumps(record))
    apply(drop=["car"])
    record["settings"]["batch"] = 2
    (world.out / "predict.json").write_text(json.dumps(record))
    with pytest.raises(OutputError, match="what `predict` made was made anew"):
        apply(drop=["car"])


@pytest.mark.parametrize("place", ["Daten 1", "öut"])
def test_no_scans_or_results_are_written_over(world, tmp_path, place):
    before = files_below(tmp_path)
    with pytest.raises(OutputError, match="holds something else"):
        filter_scans(world.out, tmp_path / place, drop=["car"], query=ResultQuery(world.dataset))
    after = {name: data for name, data in files_below(tmp_path).items() if "lock" not in name}
    assert after == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "none given"),
        ({"drop": ["persn"]}, "class persn · no such class · expected one of .*vehicle.*, person"),
        ({"max_error": 1.5}, "a probability"),
    ],
)
def test_wrong_use_is_one_line_and_writes_nothing(apply, tmp_path, options, message):
    with pytest.raises(UsageError, match=message):
        apply(**options)
    assert not (tmp_path / "to").exists()


def test_scans_that_changed_or_lack_labels_fail_alone(apply, world, tmp_path):
    path = world.dataset / "sequences/08/velodyne/000000.bin"
    path.write_bytes(path.read_bytes() + bytes(16))
    output_path(world.out, "08", "predictions", "000001").unlink()
    write_array(output_path(world.out, "08", "uncertainty/entropy", "000001"), np.zeros(4, "f4"))
    outcome = apply(drop=["car"])
    reasons = [failure.reason for failure in outcome.failures]
    assert "8 points · expected 7, as it has labels" in reasons[0]
    assert "no label known" in reasons[1]
    assert not (tmp_path / "to/sequences/08/velodyne").exists()


def test_recordings_are_refused_unless_masks_are_asked_for(tmp_path):
    pytest.importorskip("rosbags")
    points = np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f4")])
    out = tmp_path / "out"
    bag = write_bag(tmp_path, ".bag", [(TOPIC, START, cloud(points))])
    write_labels(output_path(out, "drive", "predictions", str(START)), np.array([10, 40, 0, 10, 0]))
    with pytest.raises(UsageError, match=r"a recording, .* · `salsanext convert .*drive.bag DATA`"):
        filter_scans(out, tmp_path / "to", drop=["car"], query=ResultQuery(bag))
    filter_scans(out, tmp_path / "to", drop=["car"], query=ResultQuery(bag), indices=True)
    mask = np.load(tmp_path / f"to/sequences/drive/masks/{START}.npy")
    assert mask.tolist() == [False, True, True, False, True]


def test_merged_classes_have_their_own_names():
    coarse = label_space("coarse")
    assert named_classes(["vehicle"], coarse).tolist() == [i == 1 for i in range(8)]
    assert named_classes(["moving"], coarse)[1:3].all()
    with pytest.raises(UsageError, match="class car"):
        named_classes(["car"], coarse)


def test_what_is_left_is_read_by_the_other_commands(apply, tmp_path):
    apply(drop=["vehicle"])
    assert len(read_scan(tmp_path / "to/sequences/08/velodyne/000000.bin")) == 5
    with pytest.raises(NoInputError):
        filter_scans(tmp_path / "nowhere", tmp_path / "to", drop=["car"])
