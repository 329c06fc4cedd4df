# SPDX-License-Identifier: MIT
"""Bags that `filter` writes: as they were, but for the points that go."""

import resource
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scans import files_below, refused

pytest.importorskip("rosbags")

from bags import KINDS, START, STEP, TOPIC, cloud, structured, write_bag
from calls import calls_of
from captures import Sent, vlp16, write_capture
from labelled_bags import (
    CAR,
    NAMES,
    POINTS,
    ROAD,
    LabelledBag,
    label_a_file_too,
    messages_of,
    record_sources,
)

from salsanext_cli import read_scan, write_labels
from salsanext_cli.commands.line.output.progress import writing
from salsanext_cli.commands.stages.filter import filter_scans, plan_filter
from salsanext_cli.core.errors import FormatError, LabelError, NoInputError, OutputError, UsageError
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.manifest import ScanSource
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

STOP = RunOptions(on_error="stop")
AGAIN = RunOptions(overwrite=True, on_error="stop")


def visible_names(folder):
    return {path.name for path in folder.iterdir() if path.name[0] != "."}


def apply_to(bag, tmp_path):
    return partial(
        filter_scans, bag.out, tmp_path / "to", drop=["car"], query=ResultQuery(bag.topic)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_keeps_all_but_the_points_that_go(tmp_path, kind):
    bag = LabelledBag(tmp_path, kind)
    before = files_below(bag.path.parent if kind == ".bag" else bag.path)
    outcome = apply_to(bag, tmp_path)()
    assert (outcome.done, outcome.failures) == (3, ())
    assert outcome.filtered_points == FilteredPoints(18, 9)
    target = tmp_path / "to" / bag.path.name
    left = {NAMES[0]: [1, 3, 4, 5], NAMES[1]: [], NAMES[2]: [0, 1, 2, 3, 4]}
    for name, points, places in zip(NAMES, POINTS, left.values(), strict=True):
        scan = read_scan(target / TOPIC.strip("/") / name)
        for axis, column in enumerate("xyz"):
            np.testing.assert_array_equal(scan.points[:, axis], points[column][places])
    for old, new in zip(messages_of(bag.path), messages_of(target), strict=True):
        assert old[:2] == new[:2]
        if old[0] == TOPIC:
            assert str(new[2].header) == str(old[2].header)
            assert str(new[2].fields) == str(old[2].fields)
        else:
            assert new[3] == old[3]
    after = files_below(bag.path.parent if kind == ".bag" else bag.path)
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize("kind", [".bag", ".mcap"])
def test_a_bag_is_not_written_again_unless_it_shall_be_replaced(tmp_path, kind):
    bag = LabelledBag(tmp_path, kind)
    call = apply_to(bag, tmp_path)
    assert (call().done, call().skipped, call(options=AGAIN).done) == (3, 3, 3)
    with pytest.raises(OutputError, match="classes"):
        call(drop=["person"])
    assert call(drop=["person"], options=AGAIN).filtered_points.remaining == 17
    target = tmp_path / "to" / bag.path.name
    edited = target if kind == ".bag" else target / f"{target.name}.mcap"
    edited.write_bytes(b"mine")
    with pytest.raises(OutputError, match="was changed, or not written by salsanext"):
        call(drop=["person"], options=AGAIN)
    assert edited.read_bytes() == b"mine"


@pytest.mark.parametrize("kind", [".bag", ".mcap"])
def test_a_bag_that_was_recorded_further_is_written_again(tmp_path, kind):
    bag = LabelledBag(tmp_path, kind)
    call = apply_to(bag, tmp_path)
    assert call().done == 3
    bag.path.rename(tmp_path / "earlier")
    later = f"{START + 2 * STEP}"
    bag = LabelledBag(tmp_path, kind, further=[(TOPIC, int(later), cloud(POINTS[0]))])
    bag.label(later, [ROAD] * 6)
    assert call().done == 4
    assert call().skipped == 4
    assert len(read_scan(tmp_path / "to" / bag.path.name / TOPIC.strip("/") / later)) == 6


@pytest.mark.parametrize(
    "add", [lambda path: path.touch(), lambda path: path.mkdir()], ids=["file", "folder"]
)
def test_a_bag_with_something_empty_of_the_user_stays_complete(tmp_path, add):
    bag = LabelledBag(tmp_path, ".mcap")
    call = apply_to(bag, tmp_path)
    call()
    target = tmp_path / "to/drive"
    before = files_below(target)
    added = target / "COLCON_IGNORE"
    add(added)
    refused(OutputError, added, call, options=AGAIN)
    assert added.exists()
    added.rmdir() if added.is_dir() else added.unlink()
    assert files_below(target) == before
    assert call(options=AGAIN).done == 3


def test_a_bag_that_is_changed_while_it_is_written_anew_is_kept(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    call = apply_to(bag, tmp_path)
    call()
    target = tmp_path / "to/drive.bag"
    options = replace(AGAIN, progress=lambda done, total: target.write_bytes(b"mine"))
    refused(OutputError, target, call, options=options)
    assert target.read_bytes() == b"mine"


def test_clouds_without_labels_are_refused_unless_they_have_no_measurements(tmp_path):
    """The first clouds of a driver may be empty, or of NaN; `predict` refuses them."""
    nothing = structured(3)
    for axis in "xyz":
        nothing[axis] = np.nan
    further = ((TOPIC, START - 2, cloud(structured(0))), (TOPIC, START - 1, cloud(nothing)))
    bag = LabelledBag(tmp_path, ".mcap", further=further)
    call = apply_to(bag, tmp_path)
    assert call(options=STOP).filtered_points == FilteredPoints(21, 12)
    sizes = [m[2].width for m in messages_of(tmp_path / "to/drive") if m[0] == TOPIC]
    assert sizes == [0, 3, 4, 0, 5]
    call(drop=["moving"], options=AGAIN)
    sizes = [m[2].width for m in messages_of(tmp_path / "to/drive") if m[0] == TOPIC]
    assert sizes == [0, 0, 3, 0, 5]
    for name in NAMES[1:]:
        output_path(bag.out, "drive", "predictions", name).unlink()
    caught = refused(NoInputError, bag.path, call, drop=["moving"], options=AGAIN)
    assert f"4 of 5 clouds, such as {NAMES[1]}" in caught.value.problem
    assert f"salsanext predict {bag.topic}" in caught.value.hint
    assert messages_of(tmp_path / "to/drive"), "the earlier copy stays"
    # A run over the first clouds alone would leave the bag as it is.
    first = [str(START - 2), str(START - 1), *NAMES[:2]]
    record_sources(bag.out, {"drive": ScanSource(str(bag.topic), dict.fromkeys(first, ""))})
    caught = refused(NoInputError, bag.path, call, drop=["moving"], options=AGAIN)
    assert caught.value.hint == f"run `salsanext predict {bag.topic} {bag.out}` first"


def test_only_the_first_cloud_that_lacks_labels_is_read_again(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    for name in NAMES[1:]:
        output_path(bag.out, "drive", "predictions", name).unlink()
    with calls_of(read_scan) as readings:
        refused(NoInputError, bag.path, apply_to(bag, tmp_path), options=STOP)
    assert [reading["path"] for reading in readings] == [bag.topic / NAMES[1]]


def test_a_bag_that_a_power_cut_emptied_is_written_again(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    call = apply_to(bag, tmp_path)
    call()
    target = tmp_path / "to/drive.bag"
    content = target.read_bytes()
    target.write_bytes(b"")
    assert call(options=STOP).done == 3
    assert len(target.read_bytes()) == len(content)


def test_points_above_an_error_go(tmp_path):
    bag = LabelledBag(tmp_path, ".db3")
    for name in NAMES:
        bag.put(name, [0, 0.1, 0.2, np.nan, 1, 0.05])
    outcome = apply_to(bag, tmp_path)(drop=(), max_error=0.1)
    assert outcome.filtered_points == FilteredPoints(18, 9, without_error=3)


def two_bags(tmp_path):
    """Return a bag whose last cloud has a label too many, and the bag `evening`."""
    bag = LabelledBag(tmp_path, ".bag")
    other = LabelledBag(tmp_path, ".mcap", name="more")
    evening = tmp_path / "evening"
    other.path.rename(evening)
    for name in NAMES:
        bag.label(name, [ROAD] * 6, "evening")
    bag.label(NAMES[2], [CAR] * 7)
    stems = dict.fromkeys(NAMES, "")
    folders = {"drive": bag.topic, "evening": evening / TOPIC.strip("/")}
    sources = {name: ScanSource(str(folder), stems) for name, folder in folders.items()}
    record_sources(bag.out, sources)
    return bag, evening


def test_a_bag_that_fails_leaves_those_of_others(tmp_path):
    bag, _ = two_bags(tmp_path)
    call = partial(filter_scans, bag.out, tmp_path / "to", drop=["car"])
    progress = []
    counting = RunOptions(progress=lambda *numbers: progress.append(numbers))
    outcome = call(options=counting)
    (failure,) = outcome.failures
    assert (failure.code, outcome.done) == ("label", 3)
    assert outcome.filtered_points == FilteredPoints(18, 18)
    assert progress == [(done, 6) for done in range(7)], "the failed cloud was attempted"
    assert visible_names(tmp_path / "to") == {"filter.json", "evening"}
    with pytest.raises(LabelError):
        call(options=STOP)
    bag.label(NAMES[2], [ROAD] * 6)
    progress.clear()
    assert call(options=counting).done == 3
    assert progress == [(done, 3) for done in range(4)], "nothing counts the bag that was done"
    assert call(options=counting).skipped == 6
    assert len(progress) == 4


@pytest.mark.parametrize(
    ("last", "statement", "names"),
    [
        (2, "no scan is finished in this run", None),
        (4, "3 of 6 scans are processed; no file is incomplete", {"filter.json", "drive.bag"}),
    ],
)
def test_an_interrupted_run_has_the_clouds_of_complete_bags(tmp_path, last, statement, names):
    """`last`: number of the cloud after which the signal arrives."""
    bag, _ = two_bags(tmp_path)
    bag.label(NAMES[2], [ROAD] * 6)
    call = partial(filter_scans, bag.out, tmp_path / "to", drop=["car"])
    with writing("filter", True) as written:

        def interrupt(done, total):
            written(done, total)
            if done == last:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            call(options=RunOptions(progress=interrupt))
        assert written.finished() == statement
    if names is None:
        assert not (tmp_path / "to").exists()
    else:
        assert visible_names(tmp_path / "to") == names
    assert call().done == 6 - last // 3 * 3


def test_a_plan_names_the_bags_that_fail_before_they_are_read(tmp_path, caplog):
    bag = LabelledBag(tmp_path, ".bag")
    apply_to(bag, tmp_path)()
    record = tmp_path / "to/.filter.bags.json"
    record.write_bytes(b"[")
    plan = partial(plan_filter, bag.out, tmp_path / "to", drop=["car"])
    query = ResultQuery(bag.topic)
    foreseen = plan(query=query)
    assert (foreseen.done, [scan.stem for scan in foreseen.todo]) == (0, [NAMES[0]])
    assert f"drive/{NAMES[0]}: {record}: " in caplog.text
    refused(OutputError, record, plan, query=query, options=STOP)


def test_a_shard_has_some_of_the_bags(tmp_path):
    bag, _ = two_bags(tmp_path)
    bag.label(NAMES[2], [ROAD] * 6)
    for number, name in ((1, "drive.bag"), (2, "evening")):
        target = tmp_path / f"part {number}"
        options = RunOptions(shard=Shard(number, 2))
        filter_scans(bag.out, target, drop=["car"], options=options)
        assert visible_names(target) == {"filter.json", name}


def test_topics_that_keep_their_points_are_named(tmp_path, caplog):
    bag = LabelledBag(tmp_path, ".bag")
    apply_to(bag, tmp_path)()
    assert "all their points: /rear\n" in caplog.text
    assert f"predict {tmp_path}/to/drive.bag/rear OUT" in caplog.text


def test_a_limit_is_refused(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    call = partial(filter_scans, bag.out, tmp_path / "to", drop=["car"])
    query = ResultQuery(bag.topic, selection=ScanSelection(limit=2))
    refused(UsageError, "limit", call, query=query)
    assert not (tmp_path / "to").exists()


def test_files_beside_bags_are_refused_and_the_hint_filters_the_bags(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    label_a_file_too(bag, tmp_path / "evening")
    call = partial(filter_scans, bag.out, tmp_path / "to", drop=["car"])
    caught = refused(UsageError, bag.path, call)
    assert 'sequences=("drive",)' in caught.value.hint
    assert not (tmp_path / "to").exists()
    selected = ResultQuery(selection=ScanSelection(sequences=("drive",)))
    assert call(query=selected).done == 3


def test_captures_are_refused(tmp_path):
    pytest.importorskip("velodyne_decoder")
    distances = np.full((12, 32), 9)
    packets = [vlp16(4.8 * n % 360, distances, distances, 1327 * n) for n in range(150)]
    path = write_capture(tmp_path / "drive.pcap", map(Sent, packets))
    out = tmp_path / "out"
    for scan in find_scans(path):
        write_labels(output_path(out, scan.sequence, "predictions", scan.stem), np.uint32([ROAD]))
    call = partial(filter_scans, out, tmp_path / "to", drop=["car"])
    caught = refused(UsageError, path, call, query=ResultQuery(path))
    assert f"salsanext convert {path} DATA" in caught.value.hint


def test_a_damaged_bag_leaves_nothing(tmp_path):
    """A cloud whose data end too early, after those of the other scans were written."""
    bag = LabelledBag(tmp_path, ".bag")
    short = cloud(POINTS[0], data=np.zeros(10, np.uint8))
    damaged = LabelledBag(tmp_path / "b", ".bag", further=((TOPIC, START + 2 * STEP, short),))
    damaged.label(f"{START + 2 * STEP}", [ROAD] * 6)
    scan = damaged.topic / f"{START + 2 * STEP}"
    call = apply_to(damaged, tmp_path)
    refused(FormatError, scan, call, options=STOP)
    assert not (tmp_path / "to").exists()
    assert [failure.code for failure in call().failures] == ["format"]
    assert not (tmp_path / "to").exists()
    damaged.path.write_bytes(bag.path.read_bytes())
    assert call().done == 3


def test_the_record_of_a_run_stays_beside_files_of_the_user_and_earlier_bags(tmp_path):
    bag, _ = two_bags(tmp_path)
    call = partial(filter_scans, bag.out, tmp_path / "to", drop=["car"])
    call()
    for _ in range(2):
        assert len(call(options=RunOptions(overwrite=True)).failures) == 1
        assert visible_names(tmp_path / "to") == {"filter.json", "evening"}


@pytest.mark.parametrize("times", [[], [START, START + STEP]], ids=["fewer", "more"])
def test_a_bag_with_other_clouds_than_its_index_is_refused(tmp_path, times):
    """The bag is replaced by another while the run begins."""
    bag = LabelledBag(tmp_path, ".bag")
    clouds = [(TOPIC, time, cloud(POINTS[0])) for time in [START, START + STEP, *times]]
    other = write_bag(tmp_path / "other", ".bag", clouds)
    options = replace(STOP, progress=lambda done, total: bag.path.write_bytes(other.read_bytes()))
    with pytest.raises(FormatError, match="index"):
        apply_to(bag, tmp_path)(options=options)
    assert not (tmp_path / "to").exists()


@pytest.mark.parametrize("kind", [".bag", ".db3"])
def test_a_full_disk_names_the_new_bag(tmp_path, kind):
    bag = LabelledBag(tmp_path, kind)
    call = apply_to(bag, tmp_path)
    target = tmp_path / "to" / bag.path.name
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_the_disk(done, total):
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))

    try:
        refused(OutputError, target, call, options=replace(STOP, progress=fill_the_disk))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (tmp_path / "to").exists()
    assert call().done == 3
