# SPDX-License-Identifier: MIT
import ast
import re
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from evaluation_runs import World
from scans import files_below, make_scan, refused, write_array, write_bin

from salsanext_cli import LabelSpace, Scan, label_space, sensor, write_labels
from salsanext_cli.commands.line.commands.filter import _filter_numbers
from salsanext_cli.commands.stages.filter import filter_scans, plan_filter
from salsanext_cli.core.classes.merging import named_classes
from salsanext_cli.core.errors import FormatError, NoInputError, OutputError, UsageError
from salsanext_cli.core.geometry.scan_traits import traits_of
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.io.frames import FRAMES, encode_frames, read_frames
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.manifest import Manifest, StageRecord
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection

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


def record_sensor(world, **fields):
    """Record labels of `predict` with an HDL-64 of some fields."""
    recorded = replace(sensor("hdl64"), **fields).to_dict()
    settings = {"label_space": SPACE.to_dict(), "sensor": recorded}
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )


def remaining(tmp_path, stem="000000"):
    """Return the indices of the remaining records of a scan."""
    source = np.fromfile(tmp_path / f"Daten 1/sequences/08/velodyne/{stem}.bin", "V16")
    found = np.fromfile(tmp_path / f"to/sequences/08/velodyne/{stem}.bin", "V16")
    places = [i for i, each in enumerate(source) if each in found]
    assert source[places].tobytes() == found.tobytes()
    return places


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"drop": ["person", "vehicle"]}, [3, 4, 5, 6]),
        ({"drop": ["moving"]}, [4, 5, 6]),
        ({"keep": ["vehicle"], "drop": ["truck"]}, [0]),
        ({"keep": ["unlabeled", "vegetation"]}, [5, 6]),
    ],
)
def test_classes_are_fine_coarse_or_movable(apply, tmp_path, options, expected):
    outcome = apply(**options)
    assert remaining(tmp_path) == expected
    counts = outcome.filtered_points
    assert (counts.points, counts.remaining) == (11, len(expected) + 4 * ("keep" not in options))


def test_scans_that_were_moved_out_of_a_map_keep_their_frames(apply, world, tmp_path):
    frame = (690_000.0, 5_330_000.0, 0.0)
    written = encode_frames({"000001": frame})
    (world.dataset / "sequences/08" / FRAMES).write_bytes(written)
    apply(drop=["person"])
    assert (tmp_path / "to/sequences/08" / FRAMES).read_bytes() == written


@pytest.mark.parametrize("overwrite", [False, True])
def test_scans_whose_frame_changes_are_filtered_again(apply, world, tmp_path, overwrite):
    """The points of a copy are in the frame of the scan at that time."""
    source = world.dataset / "sequences/08" / FRAMES
    target = tmp_path / "to/sequences/08" / FRAMES
    source.write_bytes(encode_frames({"000001": (690_000.0, 5_330_000.0, 0.0)}))
    assert apply(drop=["person"]).done == 2
    options = RunOptions(overwrite=overwrite)
    query = ResultQuery(world.dataset)
    again = partial(apply, drop=["person"], options=options)
    plan = partial(
        plan_filter, world.out, tmp_path / "to", drop=["person"], query=query, options=options
    )
    source.write_bytes(encode_frames({"000001": (690_000.0, 5_330_000.0, 47.5)}))
    assert [scan.stem for scan in plan().todo] == ["000000", "000001"][1 - overwrite :]
    assert again().done == 1 + overwrite
    assert target.read_bytes() == source.read_bytes()
    assert again().done == 2 * overwrite
    source.unlink()
    assert again().done == 1 + overwrite
    assert not target.exists()
    assert remaining(tmp_path, "000001") == [0, 1, 2, 3]


def test_frames_of_scans_that_are_not_filtered_stay(apply, world, tmp_path):
    source = world.dataset / "sequences/08" / FRAMES
    target = tmp_path / "to/sequences/08" / FRAMES
    frames = dict.fromkeys(("000000", "000001"), (690_000.0, 5_330_000.0, 0.0))
    source.write_bytes(encode_frames(frames))
    apply(drop=["person"])
    source.write_bytes(encode_frames({"000000": (1.0, 2.0, 3.0)}))
    first = ResultQuery(world.dataset, ScanSelection(limit=1))
    assert apply(drop=["person"], query=first).done == 1
    assert read_frames(target) == frames | {"000000": (1.0, 2.0, 3.0)}


def test_a_plan_has_no_size_for_a_scan_that_is_a_dangling_link(world, tmp_path):
    first = world.dataset / "sequences/08/velodyne/000000.bin"
    size = first.with_name("000001.bin").stat().st_size
    first.unlink()
    first.symlink_to(tmp_path / "gone")
    query = ResultQuery(world.dataset)
    plan = plan_filter(world.out, tmp_path / "to", drop=["person"], query=query)
    assert ([scan.stem for scan in plan.todo], plan.size) == (["000000", "000001"], size)


def test_a_shard_changes_frames_of_its_scans_only(apply, world, tmp_path):
    source = world.dataset / "sequences/08" / FRAMES
    target = tmp_path / "to/sequences/08" / FRAMES
    source.write_bytes(encode_frames(dict.fromkeys(("000000", "000001"), (1.0, 2.0, 3.0))))
    apply(drop=["person"])
    copies = files_below(target.parent / "velodyne")
    frames = dict.fromkeys(("000000", "000001"), (4.0, 5.0, 6.0))
    source.write_bytes(encode_frames(frames))
    assert apply(drop=["person"], options=RunOptions(shard=Shard(1, 2))).done == 1
    assert files_below(target.parent / "velodyne") == copies
    assert read_frames(target) == frames | {"000001": (1.0, 2.0, 3.0)}
    assert apply(drop=["person"], options=RunOptions(shard=Shard(2, 2))).done == 1
    assert read_frames(target) == frames


def test_frames_that_the_user_edited_are_refused_before_any_result_is_removed(
    apply, world, tmp_path
):
    source = world.dataset / "sequences/08" / FRAMES
    target = tmp_path / "to/sequences/08" / FRAMES
    frames = {"000001": (690_000.0, 5_330_000.0, 0.0)}
    source.write_bytes(encode_frames(frames))
    apply(drop=["person"])
    target.write_bytes(encode_frames({"000001": (690_007.5, 5_330_000.0, 0.0)}))
    before = files_below(tmp_path / "to")
    for options in ({"drop": ["person"]}, {"drop": ["car"], "options": RunOptions(overwrite=True)}):
        refused(OutputError, target, apply, **options)
        query = ResultQuery(world.dataset)
        refused(
            OutputError, target, plan_filter, world.out, tmp_path / "to", query=query, **options
        )
        assert files_below(tmp_path / "to") == before
    source.write_bytes(target.read_bytes())
    apply(drop=["car"], options=RunOptions(overwrite=True))
    assert target.read_bytes() == source.read_bytes(), "the same frames are no change"
    assert OwnedFolder(tmp_path / "to").foreign_files([target]) == [target]


@pytest.mark.parametrize("content", ['{"000001": [1.0, 2.0, 3.0]}', "[]"])
def test_frames_that_only_the_user_stated_stay(apply, tmp_path, content):
    target = tmp_path / "to/sequences/08" / FRAMES
    apply(drop=["person"])
    target.write_text(content)
    assert apply(drop=["car"], options=RunOptions(overwrite=True)).done == 2
    assert target.read_text() == content
    assert OwnedFolder(tmp_path / "to").foreign_files([target]) == [target]


def test_a_file_of_the_name_of_frames_loses_no_results(apply, world, tmp_path, caplog):
    again = RunOptions(overwrite=True)
    path = world.dataset / "sequences/08" / FRAMES
    path.write_text('[{"file": "000000.bin", "time": 1.0}]')
    assert apply(drop=["person"]).done == 2
    assert apply(drop=["car"], options=again).done == 2
    assert str(path) in caplog.text
    assert not (tmp_path / "to/sequences/08" / FRAMES).exists()
    path.unlink()
    path.mkdir()
    before = files_below(tmp_path / "to")
    refused(FormatError, path, apply, drop=["person"], options=again)
    assert files_below(tmp_path / "to") == before


DAMAGED = '{"000001": [690000, 5330000, NaN]}'
"""A slip in a file of frames."""


@pytest.mark.parametrize("content", [DAMAGED, '{"000001": [1, 2, 3],}', "[]"])
def test_frames_that_are_damaged_or_gone_to_another_program_lose_no_results(
    apply, world, tmp_path, content
):
    path = world.dataset / "sequences/08" / FRAMES
    path.write_bytes(encode_frames({"000001": (690_000.0, 5_330_000.0, 0.0)}))
    apply(drop=["person"])
    before = files_below(tmp_path / "to")
    path.write_text(content)
    for options in (RunOptions(), RunOptions(overwrite=True)):
        refused(FormatError, path, apply, drop=["person"], options=options)
        assert files_below(tmp_path / "to") == before


def test_moving_points_go_with_vehicle_housing_and_no_measurements(apply, world, tmp_path):
    """All seven points are trees; one is of the housing, one of the vehicle, three are none."""
    points = [[9, 0, 0], [0.5, 0, 0], [-2, 1, -1], [0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]]
    points = np.array([*points, [-2, 1, 5]], np.float32)
    path = world.dataset / "sequences/08/velodyne/000000.bin"
    path.write_bytes(np.c_[points, np.arange(7)].astype(np.float32).tobytes())
    predicted = output_path(world.out, "08", "predictions", "000000")
    write_labels(predicted, np.full(7, TREE, np.uint32))
    record_sensor(world, min_range=1.0, ego_box=(-3.0, -1.0, -2.0, 1.0, 1.0, 0.5))
    apply(drop=["moving"])
    assert remaining(tmp_path) == [0, 6]
    apply(drop=["person", "vehicle"], options=RunOptions(overwrite=True))
    assert remaining(tmp_path) == [*range(7)]


def test_moving_points_go_by_the_sensor_that_was_fitted_to_the_scan(apply, world, tmp_path):
    points = make_scan(3000).points
    scan = Scan(points, np.arange(3000, dtype=np.float32))
    write_bin(world.dataset / "sequences/08/velodyne/000000.bin", scan)
    predicted = output_path(world.out, "08", "predictions", "000000")
    write_labels(predicted, np.full(3000, TREE, np.uint32))
    traits = traits_of(scan).compared
    other = replace(sensor("hdl64"), min_range=6.0, ego_box=(), traits=traits)
    usual = tuple(10 * trait for trait in traits)
    record_sensor(world, min_range=0.0, ego_box=(), traits=usual, others=(other,))
    apply(drop=["moving"])
    assert remaining(tmp_path) == np.flatnonzero(np.linalg.norm(points, axis=1) >= 6).tolist()


def test_points_above_an_error_go(apply, world, tmp_path):
    world.put("uncertainty/error", "000000", [0, 0.1, 0.2, 0.05, 1, 0, 0])
    outcome = apply(max_error=0.1, drop=["car"])
    assert remaining(tmp_path) == [1, 3, 5, 6]
    assert [failure.scan.stem for failure in outcome.failures] == ["000001"]


def test_points_without_an_error_go_and_are_counted(apply, world, tmp_path):
    """The car without an error goes because of its class."""
    world.put("uncertainty/error", "000000", [np.nan, 0.1, np.nan, np.nan, 1, 0, np.nan])
    world.put("uncertainty/error", "000001", [0, np.nan, 0.5, 0])
    outcome = apply(max_error=0.1, drop=["car"])
    assert remaining(tmp_path) == [1, 5]
    assert remaining(tmp_path, "000001") == [0, 3]
    assert outcome.filtered_points == FilteredPoints(11, 4, without_error=4)
    numbers = _filter_numbers(outcome)
    (line,) = numbers.lines
    assert "4 of 11 points remain; 4 points dropped without" in line
    assert (numbers.data["accepted_points"], numbers.data["points_without_error"]) == (4, 4)


def test_a_folder_that_has_points_without_an_error_is_not_continued(apply, world, tmp_path):
    world.put("uncertainty/error", "000000", [0] * 7)
    world.put("uncertainty/error", "000001", [0] * 4)
    assert apply(max_error=0.1).done == 2
    target = tmp_path / "to"
    record = Manifest(target).record("filter")
    earlier = {k: value for k, value in record.settings.items() if k != "with_error_only"}
    assert earlier != record.settings
    Manifest(target).write(replace(record, settings=earlier))
    refused(OutputError, target / "filter.json", apply, max_error=0.1)


@pytest.mark.parametrize("kind", ["error", "least_confidence"])
def test_remaining_points_whose_label_was_rejected_are_counted(
    apply, world, tmp_path, caplog, kind
):
    """Points 2 and 6 of the first scan were rejected; point 5 never had a label."""
    predicted = output_path(world.out, "08", "predictions", "000000")
    write_labels(predicted, np.uint32([CAR, TRUCK, 0, RIDER, ROAD, 0, 0]))
    world.put(f"uncertainty/{kind}", "000000", [0, 0.1, 0.6, 0.5, 0, np.nan, 1])
    world.put(f"uncertainty/{kind}", "000001", [0.9, 0, 0, 0])
    settings = {"label_space": SPACE.to_dict(), "sensor": sensor("hdl64").to_dict(), "reject": 0.5}
    if kind != "error":
        settings["reject_by"] = kind
    Manifest(world.out).write(
        StageRecord(stage="predict", settings=settings, writes=("predictions",))
    )
    outcome = apply(drop=["vehicle"])
    assert remaining(tmp_path) == [2, 3, 4, 5, 6]
    assert outcome.filtered_points == FilteredPoints(11, 9, rejected=2)
    assert _filter_numbers(outcome).data["accepted_without_label"] == 2
    (names,) = re.findall(r"drop=(\(.*\)) and overwrite=True", caplog.text)
    caplog.clear()
    outcome = apply(drop=ast.literal_eval(names), options=RunOptions(overwrite=True))
    assert remaining(tmp_path) == [3, 4]
    assert outcome.filtered_points.rejected == 0
    assert not caplog.text
    apply(keep=["unlabeled", "road"], options=RunOptions(overwrite=True))
    assert not caplog.text, "the points were asked for"


def test_masks_of_an_earlier_version_are_replaced_only_if_wanted(apply, tmp_path):
    mask = tmp_path / "to/sequences/08/masks/000000.npy"
    settings = {"results": "out", "classes": ["car"], "indices": True}
    Manifest(tmp_path / "to").write(StageRecord(stage="filter", settings=settings))
    OwnedFolder(tmp_path / "to", "filter").write(mask, b"mask")
    with pytest.raises(OutputError, match="indices was true and is not set"):
        apply(keep=["car"])
    assert mask.exists()
    assert apply(keep=["car"], options=RunOptions(overwrite=True)).done == 2
    assert (remaining(tmp_path), mask.exists()) == ([0], False)


def test_a_scan_without_remaining_points_is_a_warning(apply, tmp_path, caplog):
    apply(drop=["road"])
    assert "1 scan: 08/000001" in caplog.text
    written = tmp_path / "to/sequences/08/velodyne/000001.bin"
    assert not written.exists()
    apply(drop=["car"], options=RunOptions(overwrite=True))
    assert written.exists()
    apply(drop=["road"], options=RunOptions(overwrite=True))
    assert not written.exists()


@pytest.mark.usefixtures("workers_in_process")
def test_shards_workers_and_restarts_write_the_same(apply, tmp_path):
    apply(drop=["car"])
    first = files_below(tmp_path / "to")
    shutil.rmtree(tmp_path / "to")
    for number in (1, 2):
        outcome = apply(drop=["car"], options=RunOptions(shard=Shard(number, 2), jobs=2))
        assert outcome.done == 1
    assert files_below(tmp_path / "to") == first
    assert apply(drop=["car"]).skipped == 2


def test_other_settings_are_refused_or_replace_written_files_only(apply, world, tmp_path):
    apply(drop=["car"])
    with pytest.raises(OutputError, match="classes"):
        apply(drop=["truck"])
    record_sensor(world)
    with pytest.raises(OutputError):
        apply(drop=["car"])
    (world.out / "predict.json").unlink()
    edited = tmp_path / "to/sequences/08/velodyne/000000.bin"
    edited.write_bytes(b"mine")
    again = RunOptions(overwrite=True)
    for outcome in (apply(drop=["car"]), apply(drop=["truck"], options=again)):
        assert outcome.failures[0].reason.startswith(f"{edited}: ")
        assert edited.read_bytes() == b"mine"
    assert remaining(tmp_path, "000001") == [0, 1, 2, 3]


def test_a_run_with_other_settings_waits_for_one_that_has_written_nothing_yet(apply, tmp_path):
    target = tmp_path / "to"
    target.mkdir()
    record = StageRecord(stage="filter", settings={"classes": ["car"]})
    with OwnedFolder(target, "filter").open(shared=True):
        Manifest(target).write(record)
        refused(OutputError, target, apply, drop=["truck"])
    assert Manifest(target).record("filter") == record


def test_no_scans_or_results_are_written_over(world, tmp_path):
    before = files_below(tmp_path)
    with pytest.raises(OutputError):
        filter_scans(world.out, world.dataset, drop=["car"], query=ResultQuery(world.dataset))
    after = {name: data for name, data in files_below(tmp_path).items() if "lock" not in name}
    assert after == before


def test_wrong_use_is_one_line_and_writes_nothing(apply, tmp_path):
    for options in ({}, {"drop": ["persn"]}, {"max_error": 1.5}):
        with pytest.raises(UsageError):
            apply(**options)
    with pytest.raises(NoInputError):
        apply(max_error=0.5)
    assert not (tmp_path / "to").exists()


def test_scans_that_changed_or_lack_labels_fail_alone(apply, world, tmp_path):
    path = world.dataset / "sequences/08/velodyne/000000.bin"
    path.write_bytes(path.read_bytes() + bytes(16))
    output_path(world.out, "08", "predictions", "000001").unlink()
    write_array(output_path(world.out, "08", "uncertainty/entropy", "000001"), np.zeros(4, "f4"))
    outcome = apply(drop=["car"])
    assert [failure.scan.stem for failure in outcome.failures] == ["000000", "000001"]
    assert "8 points" in outcome.failures[0].reason
    assert not (tmp_path / "to/sequences/08/velodyne").exists()


def test_classes_are_those_of_the_label_space():
    coarse = label_space("coarse")
    assert named_classes(["vehicle"], coarse).tolist() == [i == 1 for i in range(8)]
    assert named_classes(["moving"], coarse)[1:3].all()
    silent = LabelSpace.from_dict(SPACE.to_dict() | {"movable": []})
    assert named_classes(["car"], silent).tolist() == [i == 1 for i in range(20)]
    for name, space in (("car", coarse), ("moving", silent)):
        refused(UsageError, f"class {name}", named_classes, [name], space)
