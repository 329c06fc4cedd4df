# SPDX-License-Identifier: MIT
import copy
import hashlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from calls import calls_of
from las_files import write_las
from scans import SMALL, files_below, make_scan, refused, write_sequence, write_weights
from shallow_network import shallow  # noqa: F401
from world import Stored

from salsanext_cli import (
    knn_refine,
    label_space,
    project,
    read_labels,
    read_scan,
    sample,
    write_labels,
)
from salsanext_cli.commands.stages.pick import pick, plan_pick
from salsanext_cli.core.errors import (
    FormatError,
    NoInputError,
    OutputError,
    UsageError,
    WeightsError,
)
from salsanext_cli.core.measures.scan_choice import choose_scans
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.frames import FRAMES, encode_frames, read_frames
from salsanext_cli.runs.annotation.map_frames import frames_beside, missing_frames, write_frames
from salsanext_cli.runs.annotation.picked_data_set import PickedDataSet
from salsanext_cli.runs.annotation.scan_description import DescribeJob
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection

PASSES = {"samples": 2, "seed": 0}


@pytest.fixture(autouse=True, scope="module")
def few_samples():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("salsanext_cli.commands.stages.pick.SAMPLES", PASSES["samples"])
        yield


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Return weights of the shallow network: what it computes does not matter here."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors")


@pytest.fixture
def world(world):
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


@pytest.fixture
def drive(world):
    """Return the world with a drive of six scans, no two of them equal, with poses."""
    return with_drive(world)


@pytest.fixture(scope="module")
def once_picked(tmp_path_factory, weights, few_samples):
    folder = tmp_path_factory.mktemp("picked")
    return Stored(folder, weights, lambda world: run(with_drive(world.unfitted())))


@pytest.fixture
def picked(once_picked):
    """Return the drive, three scans of which are picked."""
    return once_picked.restored().unfitted()


def with_drive(world):
    sequence = world.data / "sequences/08"
    write_sequence(sequence, [f"{10 * i:06d}" for i in range(6)], labels=False, seed=20)
    (sequence / "velodyne/000001.bin").unlink()
    shutil.rmtree(world.data / "sequences/00")
    (sequence / "poses.txt").write_text("".join(f"{i} 0 0\n" for i in range(6)))
    (sequence / "calib.txt").write_text("Tr: 1 0 0\n")
    return world


def run(world, source=None, out=None, *, jobs=1, overwrite=False, progress=None, **how):
    events = how.pop("events", None)
    options = RunOptions(jobs=jobs, overwrite=overwrite, progress=progress, events=events)
    given = {"settings": world.network, "count": 3} | how
    return pick(source or world.data, out or world.out, options=options, **given)


def names(found):
    return [each.name for each in found.picked]


def of_folder(world, folder):
    return sorted(path.name for path in (world.out / "sequences/08" / folder).iterdir())


def test_the_choice_follows_from_the_descriptions(drive):
    network = drive.network.load()
    scans = find_scans(drive.data)
    described = [*Pipeline(job=DescribeJob(network=network, **PASSES)).results(scans)]
    features = [each.features for each in described]
    doubt = [each.uncertainty for each in described]
    found = run(drive)
    expected = [each.scan for each in choose_scans(features, doubt, 3)]
    assert names(found) == [scans[number].name for number in expected]
    assert [each.uncertainty for each in found.picked] == [doubt[number] for number in expected]
    assert found.scans == 6


def test_the_data_set_is_ready_to_label(picked):
    found = run(picked)
    network, space = picked.network.load(), label_space()
    stems = sorted(each.scan for each in found.picked)
    for folder, suffix in (("velodyne", "bin"), ("labels", "label"), ("ply", "ply")):
        assert of_folder(picked, folder) == [f"{stem}.{suffix}" for stem in stems]
    poses = (picked.out / "sequences/08/poses.txt").read_text().splitlines()
    assert poses == [f"{int(stem) // 10} 0 0" for stem in stems]
    assert (picked.out / "sequences/08/calib.txt").read_text() == "Tr: 1 0 0\n"
    scans = find_scans(picked.out)
    assert [scan.stem for scan in scans] == stems
    for scan in scans:
        source = picked.scan("08", scan.stem)
        assert scan.path.read_bytes() == source.read_bytes()
        original = next(s for s in find_scans(picked.data) if s.stem == scan.stem)
        image = project(read_scan(original.path), network.sensor)
        softmax = sample(network, image, **PASSES).probabilities
        labels = knn_refine(image, softmax.argmax(axis=0))
        raw = read_labels(scan.label_path, len(labels))
        np.testing.assert_array_equal(raw, space.to_raw(labels))
    written = label_space(picked.out / "labels.yaml")
    assert written.fits(space)
    assert written.splits == {"train": ("08",), "valid": (), "test": ()}
    lines = (picked.out / "picked.csv").read_text().splitlines()
    assert [line.split(",")[2] for line in lines[1:]] == [each.scan for each in found.picked]


def test_clouds_name_their_scalars_for_cloudcompare(drive):
    plyfile = pytest.importorskip("plyfile")
    run(drive, count=1)
    (path,) = (drive.out / "sequences/08/ply").iterdir()
    points = plyfile.PlyData.read(path)["vertex"].data
    space = label_space()
    raw = read_labels(path.parents[1] / "labels" / f"{path.stem}.label")
    np.testing.assert_array_equal(points["scalar_label"], raw)
    rgb = np.stack([points[name] for name in ("red", "green", "blue")], axis=1)
    np.testing.assert_array_equal(rgb, space.colours[space.to_train(raw)])
    scan, again = read_scan(drive.scan("08", path.stem)), read_scan(path)
    np.testing.assert_array_equal(again.points, scan.points)
    np.testing.assert_array_equal(again.intensity, scan.intensity)
    assert (points["scalar_uncertainty"] >= 0).all()


def test_intensity_stays_on_the_scale_of_the_files(drive):
    scan, path = make_scan(), drive.data / "five.bin"
    table = [*scan.points.T, np.zeros(len(scan)), 200 * scan.intensity]
    path.write_bytes(np.stack(table, axis=1).astype("<f4").tobytes())
    columns = ("x", "y", "z", "_", "intensity")
    sensor = replace(SMALL, columns=columns, intensity_scale=255.0)
    run(drive, path, count=1, settings=replace(drive.network, sensor=sensor))
    (written,) = find_scans(drive.out)
    np.testing.assert_allclose(read_scan(written.path).intensity, 200 * scan.intensity, rtol=1e-6)


@pytest.mark.usefixtures("workers_in_process")
def test_workers_and_order_change_nothing(drive, tmp_path):
    alone, many = tmp_path / "alone", tmp_path / "many"
    run(drive, out=alone)
    run(drive, out=many, jobs=2)
    assert files_below(alone) == files_below(many)


def test_missing_files_are_written_and_existing_ones_stay(picked):
    first, before = run(picked), files_below(picked.out)
    edited, lost = list((picked.out / "sequences/08/labels").iterdir())[:2]
    write_labels(edited, read_labels(edited) * 0 + 10)
    (picked.out / "labels.yaml").write_text("mine\n")
    kept = files_below(picked.out)
    again = run(picked)
    assert again.picked == first.picked
    assert (again.outcome.skipped, again.outcome.done) == (3, 0)
    assert files_below(picked.out) == kept
    lost.unlink()
    (picked.out / "picked.csv").unlink()
    assert run(picked).outcome.done == 3
    assert files_below(picked.out) == kept
    assert kept.keys() == before.keys()


def test_other_settings_need_another_folder_or_overwrite(picked):
    before = files_below(picked.out)
    for how, difference in (
        ({"count": 4}, "count was 3 and is 4"),
        ({"selection": ScanSelection(limit=5)}, 'scans was "6, .*and is "5, '),
    ):
        with pytest.raises(OutputError, match=difference):
            run(picked, **how)
    assert files_below(picked.out) == before
    found = run(picked, count=2, overwrite=True)
    stems = sorted(each.scan for each in found.picked)
    for folder in ("velodyne", "labels", "ply"):
        assert [name.partition(".")[0] for name in of_folder(picked, folder)] == stems
    assert len((picked.out / "sequences/08/poses.txt").read_text().splitlines()) == 2


def test_files_that_were_changed_are_never_replaced(picked):
    labels = next((picked.out / "sequences/08/labels").iterdir())
    pre_labels, record = labels.read_bytes(), picked.out / "pick.json"
    # The key of older versions.
    record.write_text(record.read_text().replace('"pre_labels"', '"guesses"'))
    for change in (
        lambda: labels.write_bytes(pre_labels[::-1]),
        # Other commands record labels there as written by salsanext.
        lambda: OwnedFolder(picked.out).write(labels, pre_labels[::-1]),
    ):
        change()
        before = files_below(picked.out)
        for how in ({}, {"count": 2}):
            refused(OutputError, labels, run, picked, overwrite=True, **how)
        assert files_below(picked.out) == before
    OwnedFolder(picked.out).write(labels, pre_labels)
    assert len(run(picked, count=2, overwrite=True).picked) == 2
    (picked.out / "import-labels.json").write_text("{}\n")
    with pytest.raises(OutputError, match=r"import-labels\.json"):
        run(picked, overwrite=True)


def test_labels_that_are_imported_during_a_run_are_not_replaced(picked):
    labels = next((picked.out / "sequences/08/labels").iterdir())
    corrected = labels.read_bytes()[::-1]

    def import_meanwhile(done, total):
        OwnedFolder(picked.out, "import-labels").write(labels, corrected)

    refused(OutputError, labels, run, picked, count=2, overwrite=True, progress=import_meanwhile)
    assert labels.read_bytes() == corrected


def test_an_interrupted_run_records_its_pre_labels_and_is_finished_later(drive, monkeypatch):
    write, labels = OwnedFolder.write_missing, []

    def interrupted(self, path, content):
        if path.suffix == ".label":
            if labels:
                raise KeyboardInterrupt
            labels.append(path)
        write(self, path, content)

    with monkeypatch.context() as patch:
        patch.setattr(OwnedFolder, "write_missing", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(drive)
    record = json.loads((drive.out / "pick.json").read_text())
    (first,) = (drive.out / "sequences/08/labels").iterdir()
    digest = hashlib.sha256(first.read_bytes()).hexdigest()
    assert record["pre_labels"][f"08/{first.stem}"] == digest
    run(drive)
    run(drive, out=drive.out / "whole")
    whole = files_below(drive.out / "whole")
    shutil.rmtree(drive.out / "whole")
    assert files_below(drive.out) == whole


def test_the_folder_of_the_scans_is_refused(drive):
    sequence = drive.data / "sequences/08"
    for out in (drive.data, sequence, sequence / "velodyne", drive.data / "sequences/../"):
        refused(UsageError, "OUT", run, drive, out=out)
    assert not (drive.data / "pick.json").exists()


def test_unreadable_scans_are_named_each_time_and_the_others_picked(drive):
    (drive.scan("08", "000030")).write_bytes(b"x" * 17)
    (drive.scan("08", "000040")).write_bytes(b"")
    for done in (3, 0):
        found = run(drive)
        assert [failure.scan.stem for failure in found.outcome.failures] == ["000030", "000040"]
        assert found.outcome.done == done
    assert found.to_dict()["failures"][0]["code"] == "format"


FRAME = (690_000.0, 5_330_000.0, 0.0)
OTHER_FRAME = (680_000.0, 5_330_000.0, 0.0)


@pytest.fixture
def two_in_map(drive):
    """Return the world with two scans, whose frames are beside them."""
    for scan in find_scans(drive.data)[2:]:
        scan.path.unlink()
    frames = {"000000": FRAME, "000010": OTHER_FRAME}
    (drive.data / "sequences/08" / FRAMES).write_bytes(encode_frames(frames))
    return drive


def interrupted(monkeypatch, world):
    """Interrupt a pick after it has written the points of a scan."""
    write = PickedDataSet.write_points

    def write_one(self, *arguments):
        write(self, *arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(PickedDataSet, "write_points", write_one)
        with pytest.raises(KeyboardInterrupt):
            run(world)


def test_an_interrupted_pick_has_the_frames_of_its_points(two_in_map, monkeypatch):
    interrupted(monkeypatch, two_in_map)
    written = find_scans(two_in_map.out)
    assert len(written) == 1
    frames = two_in_map.out / "sequences/08" / FRAMES
    every = {"000000": FRAME, "000010": OTHER_FRAME}
    assert read_frames(frames) == every
    frames.unlink()
    refused(FormatError, frames, frames_beside, written)
    assert run(two_in_map).outcome.done == 2
    assert read_frames(frames) == every


def test_a_scan_that_fails_has_its_frame_once_it_is_written(two_in_map, monkeypatch):
    write, failed = PickedDataSet.write_points, []

    def write_second(self, file, *arguments):
        if not failed:
            failed.append(file)
            raise FormatError(file.path, "is damaged", "a scan")
        write(self, file, *arguments)

    monkeypatch.setattr(PickedDataSet, "write_points", write_second)
    with calls_of(frames_beside) as readings:
        assert len(run(two_in_map).outcome.failures) == 1
    assert len(readings) == 1, "the frames of all scans are read together"
    assert run(two_in_map).outcome.failures == ()
    assert len(frames_beside(find_scans(two_in_map.out))) == 2


def run_in_map(world, **how):
    """Pick the only scan of a drive, in map coordinates."""
    return run(world, world.scan("08", "000010"), count=1, **how)


@pytest.fixture
def in_map(drive):
    """Return the world with a pick of one scan, whose frame is beside it."""
    (drive.data / "sequences/08" / FRAMES).write_bytes(encode_frames({"000010": FRAME}))
    run_in_map(drive)
    return drive


def test_frames_that_are_lost_are_written_again(in_map):
    """Without them, the next stages would take points in map coordinates for local ones."""
    written = in_map.out / "sequences/08" / FRAMES
    expected = written.read_bytes()
    assert read_frames(written) == {"000010": FRAME}
    # Those beside the scans are not needed, and may have changed or gone in the meantime.
    beside = in_map.data / "sequences/08" / FRAMES
    beside.write_bytes(encode_frames({"000010": OTHER_FRAME}))
    for lose in (lambda: written.write_bytes(b""), written.unlink, beside.unlink):
        lose()  # As a power cut, and a user
        written.unlink(missing_ok=True)
        # The points alone would be local ones.
        refused(FormatError, written, frames_beside, find_scans(in_map.out))
        assert run_in_map(in_map).outcome.skipped == 1
        assert written.read_bytes() == expected


@pytest.mark.parametrize("content", ["{}", "[]", '{"000000": [1, 2, 3]}'])
def test_frames_without_that_of_a_picked_scan_are_refused(in_map, content):
    written = in_map.out / "sequences/08" / FRAMES
    written.write_text(content)
    refused(FormatError, written, frames_beside, find_scans(in_map.out))
    # A person wrote it.
    refused(OutputError, written, run_in_map, in_map)
    how = {"settings": in_map.network, "count": 1}
    refused(OutputError, written, plan_pick, in_map.scan("08", "000010"), in_map.out, **how)
    assert written.read_text() == content


def test_a_scan_whose_frame_has_changed_is_not_mixed_with_earlier_ones(in_map):
    beside = in_map.data / "sequences/08" / FRAMES
    written = in_map.out / "sequences/08" / FRAMES
    points = in_map.out / "sequences/08/velodyne/000010.bin"
    before = points.read_bytes()
    beside.write_bytes(encode_frames({"000010": OTHER_FRAME}))
    points.unlink()
    outcome = run_in_map(in_map).outcome
    assert "another frame" in outcome.failures[0].reason
    assert read_frames(written) == {"000010": FRAME}
    assert not points.exists()
    beside.write_bytes(encode_frames({"000010": FRAME}))
    assert run_in_map(in_map).outcome.done == 1
    assert points.read_bytes() == before


def test_records_of_earlier_versions_get_the_frames(in_map):
    record = in_map.out / "pick.json"
    content = json.loads(record.read_text())
    frames = content.pop("frames")
    assert frames == {"08/000010": {"origin": list(FRAME), "is_beside": True}}
    record.write_text(json.dumps(content))
    assert run_in_map(in_map).outcome.skipped == 1
    written = in_map.out / "sequences/08" / FRAMES
    written.unlink()
    assert run_in_map(in_map).outcome.done == 1
    assert read_frames(written) == {"000010": FRAME}
    assert json.loads(record.read_text())["frames"] == frames
    # Written frames are those of the points, also if the scans have others now.
    record.write_text(json.dumps(content))
    (in_map.out / "picked.csv").unlink()
    (in_map.data / "sequences/08" / FRAMES).write_bytes(encode_frames({"000010": OTHER_FRAME}))
    assert len(run_in_map(in_map).outcome.failures) == 1
    assert json.loads(record.read_text())["frames"] == frames


def test_a_complete_pick_reads_no_frames_beside_the_scans(in_map):
    beside = in_map.data / "sequences/08" / FRAMES
    beside.write_text('{"000010": [NaN, 0, 0]}')
    assert run_in_map(in_map).outcome.skipped == 1
    planned = (plan_pick, in_map.scan("08", "000010"), in_map.out)
    how = {"settings": in_map.network, "count": 1}
    assert plan_pick(*planned[1:], **how).picked == 1
    (in_map.out / "picked.csv").unlink()
    refused(FormatError, beside, run_in_map, in_map)
    refused(FormatError, beside, *planned, **how)


def test_frames_in_the_scans_themselves_need_no_file_beside_them(drive):
    """As those of LAS files, beside which another program may have a file of this name."""
    pytest.importorskip("laspy")
    points = make_scan(1500).points + np.array(FRAME)
    path = write_las(drive.scan("08", "000010").with_suffix(".las"), points, offsets=FRAME)
    (drive.data / "sequences/08" / FRAMES).write_text("[]")
    for overwrite in (False, True):
        assert run(drive, path, count=1, overwrite=overwrite).outcome.done == 1
    written = drive.out / "sequences/08" / FRAMES
    assert read_frames(written) == {"000010": FRAME}
    copied = drive.out / "sequences/08/velodyne/000010.bin"
    assert np.abs(read_scan(copied).points + np.array(FRAME) - points).max() < 1e-3


@pytest.mark.parametrize("out", ["a" * 300, "file/out"])
def test_a_folder_that_cannot_be_written_is_refused_before_the_network_is_read(
    drive, tmp_path, out
):
    (tmp_path / "file").touch()
    unread = {"settings": replace(drive.network, weights=tmp_path / "none.safetensors")}
    path = tmp_path / out
    refused(OutputError, path, run, drive, out=path, **unread)
    refused(OutputError, path, plan_pick, drive.data, path, **unread)


@pytest.mark.parametrize("content", ['{"000000": [690000, 5330000, NaN]}', "[]"])
def test_frames_that_are_damaged_or_gone_to_another_program_lose_no_picked_scans(picked, content):
    scans = find_scans(picked.data)
    data_set = PickedDataSet(picked.out)
    write_frames(data_set, missing_frames(data_set, {scans[0]: FRAME}))
    path = picked.data / "sequences/08" / FRAMES
    path.write_text(content)
    before = files_below(picked.out)
    refused(FormatError, path, run, picked, overwrite=True)
    again = RunOptions(overwrite=True)
    how = {"settings": picked.network, "options": again}
    refused(FormatError, path, plan_pick, picked.data, picked.out, **how)
    assert files_below(picked.out) == before


def test_all_of_too_few(drive, caplog):
    caplog.set_level(NOTICE)
    alone = run(drive, drive.scan("08", "000010"))
    assert [each.reason for each in alone.picked] == ["the only scan"]
    assert "all of only 1 scan" in caplog.text


def test_the_classes_are_those_of_the_data_set_if_they_fit(drive):
    own = copy.deepcopy(label_space().to_dict())
    own |= {"name": "mine", "learning_ignore": {0: True, 1: True}}
    (drive.data / "labels.yaml").write_text(yaml.safe_dump(own))
    run(drive)
    written = label_space(drive.out / "labels.yaml")
    assert (written.name, written.ignored[:3]) == ("mine", (True, True, False))
    own["learning_map_inv"][1] = 252
    own["learning_map"][252] = 1
    (drive.data / "labels.yaml").write_text(yaml.safe_dump(own))
    run(drive, out=drive.out / "of the network")
    assert label_space(drive.out / "of the network/labels.yaml").fits(label_space())


def test_wrong_settings_are_refused_before_a_scan_is_read(drive, tmp_path):
    for how in ({"count": 0}, {"seed": -1}):
        with pytest.raises(UsageError):
            run(drive, **how)
    certain = write_weights(tmp_path / "certain.safetensors", dropout=0.0)
    with pytest.raises(WeightsError, match="dropout"):
        run(drive, settings=replace(drive.network, weights=certain))
    assert not drive.out.exists()


def test_scans_that_are_labelled_already_are_not_picked_again(picked, tmp_path):
    first = run(picked)
    more = run(picked, out=tmp_path / "more", labelled=[picked.out])
    every = {file.name for file in find_scans(picked.data)}
    assert {*names(more)} == every - {*names(first)}
    assert more.picked[0].nearest in names(first)
    with pytest.raises(NoInputError, match="labelled"):
        run(picked, out=tmp_path / "none", labelled=[picked.out, tmp_path / "more"])
    # Nothing is left to pick if the others cannot be read.
    for name in names(more):
        (picked.data / "sequences/08/velodyne" / f"{name.split('/')[1]}.bin").write_bytes(b"short")
    nothing = run(picked, out=tmp_path / "none", labelled=[picked.out])
    assert (nothing.picked, len(nothing.outcome.failures)) == ((), 3)


def test_the_scans_of_a_list_are_picked_in_its_order(drive, tmp_path):
    listed = tmp_path / "tagged.txt"
    listed.write_text("# a comment\n08/000040\n\n000010\n08/000040\n")
    found = run(drive, names=listed)
    assert names(found) == ["08/000040", "08/000010"]
    assert of_folder(drive, "velodyne") == ["000010.bin", "000040.bin"]
    assert all(each.uncertainty > 0 and each.distance is None for each in found.picked)
    assert run(drive, names=listed).outcome.skipped == 2
    listed.write_text("08/000040\n")
    with refused(OutputError, drive.out / "pick.json"):
        run(drive, names=listed)
    assert names(run(drive, names=listed, overwrite=True)) == ["08/000040"]


def test_the_scans_are_also_written_for_a_tool_at_the_first_run_or_later(picked, drive):
    tools = picked.out / "tools"
    assert not tools.exists()
    before = files_below(picked.out)
    run(picked, tool="sse")
    stems = of_folder(picked, "velodyne")
    names = [f"08_{stem.removesuffix('.bin')}.pcd" for stem in stems]
    assert sorted(files_below(tools)) == [f"sse/{name}" for name in [*names, "settings.json"]]
    assert before.items() <= files_below(picked.out).items()
    edited = tools / "sse/settings.json"
    edited.write_text("{}")
    refused(OutputError, edited, run, picked, count=2, overwrite=True)
    edited.unlink()
    run(picked, count=2, overwrite=True, tool="point-labeler")
    assert sorted(path.name for path in tools.glob("*/*")) == ["08"]
    poses = (tools / "point-labeler/08/poses.txt").read_text()
    assert len(poses.splitlines()) == 2


def test_scans_with_one_place_for_a_tool_are_refused_before_they_are_compared(drive, tmp_path):
    write_sequence(drive.data / "sequences/08", ["1_0"], labels=False)
    write_sequence(drive.data / "sequences/08_1", ["0"], labels=False)
    listed = tmp_path / "names.txt"
    listed.write_text("08/1_0\n08_1/0\n")
    for how in ({"names": listed}, {"count": 99}):
        refused(UsageError, "tool sse", run, drive, tool="sse", **how)
        assert not drive.out.exists()
        given = {"settings": drive.network, "tool": "sse", **how}
        refused(UsageError, "tool sse", plan_pick, drive.data, drive.out, **given)


def test_an_unknown_tool_is_refused_before_a_scan_is_read(drive):
    refused(UsageError, "tool pcl", run, drive, tool="pcl")
    assert not drive.out.exists()


@pytest.mark.parametrize(
    ("content", "subject"), [(b"", "is empty"), (b"# none\n", "comments"), (b"\xff\xfe", "no text")]
)
def test_a_list_without_names_is_refused(drive, tmp_path, content, subject):
    listed = tmp_path / f"{subject}.txt"
    listed.write_bytes(content)
    with refused(FormatError, listed):
        run(drive, names=listed)
    assert not drive.out.exists()


def test_unknown_names_and_a_second_choice_are_refused(drive, tmp_path):
    listed = tmp_path / "tagged.txt"
    listed.write_text("08/000040\n08/00001\n")
    with refused(UsageError, listed) as caught:
        run(drive, names=listed)
    assert "08/00001" in caught.value.headline
    listed.write_text("08/000040\n")
    with refused(UsageError, "labelled"):
        run(drive, names=listed, labelled=[drive.data])
    with refused(UsageError, "limit"):
        run(drive, names=listed, selection=ScanSelection(limit=2))
    assert not drive.out.exists()
