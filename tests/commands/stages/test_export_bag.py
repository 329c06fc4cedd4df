# SPDX-License-Identifier: MIT
"""Bags with labelled clouds, as rosbags reads them."""

from functools import partial

import numpy as np
import pytest
from scans import refused

pytest.importorskip("rosbags")

from bags import KINDS, START, TOPIC, livox, structured, write_bag
from command_line import only_json
from evaluation_runs import World
from labelled_bags import LABELS, NAMES, POINTS, LabelledBag, label_a_file_too, messages_of

from salsanext_cli import label_space, write_labels
from salsanext_cli.commands.stages.export_bag import export_bag
from salsanext_cli.core.errors import NoInputError, OutputError, UsageError
from salsanext_cli.io.formats.ros.cloud_messages import columns_of_fields
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.scan_selection import ScanSelection

NEW = f"{TOPIC}/labelled"
STOP = RunOptions(on_error="stop")


def export(bag, tmp_path):
    return partial(export_bag, bag.out, tmp_path / "to", query=ResultQuery(bag.topic), options=STOP)


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_topic_has_the_clouds_with_their_values(tmp_path, kind):
    bag = LabelledBag(tmp_path, kind)
    errors = np.random.default_rng(0).random((3, 6), np.float32)
    for name, error in zip(NAMES, errors, strict=True):
        bag.put(name, error)
    assert export(bag, tmp_path)().done == 3
    target = tmp_path / "to" / bag.path.name
    written = messages_of(target)
    old = [message for message in written if message[0] != NEW]
    assert [(m[0], m[1], m[3]) for m in old] == [(m[0], m[1], m[3]) for m in messages_of(bag.path)]
    new = [message for message in written if message[0] == NEW]
    clouds = [message for message in old if message[0] == TOPIC]
    space = label_space()
    for number, (_, time, message, _) in enumerate(new):
        assert (time, message.header) == (clouds[number][1], clouds[number][2].header)
        assert (message.height, message.width) == ((2, 3) if number == 1 else (1, 6))
        columns = columns_of_fields(message, target)
        for field in POINTS[0].dtype.names:
            np.testing.assert_array_equal(columns[field], POINTS[number][field])
        assert columns["label"].dtype == np.uint32
        assert columns["label"].tolist() == LABELS[number]
        np.testing.assert_array_equal(columns["error"], errors[number])
        rgb = np.ascontiguousarray(columns["rgb"]).view("u1").reshape(-1, 4)[:, 2::-1]
        train = space.to_train(columns["label"])
        np.testing.assert_array_equal(rgb, screen_colours(space)[train])


def test_numbers_of_objects_and_labels_of_rejected_points_are_fields(tmp_path):
    bag = LabelledBag(tmp_path, ".mcap")
    bag.label(NAMES[0], [10 | 3 << 16, 40, 10, 0, 40, 30])
    export(bag, tmp_path)()
    message = next(m[2] for m in messages_of(tmp_path / "to/drive") if m[0] == NEW)
    columns = columns_of_fields(message, bag.path)
    assert columns["label"].tolist() == [10, 40, 10, 0, 40, 30]
    assert (columns["instance"].tolist(), columns["instance"].dtype) == ([3] + [0] * 5, "u2")


@pytest.mark.parametrize("kind", [".bag", ".db3"])
def test_clouds_of_livox_become_point_clouds(tmp_path, kind):
    points = structured(8)
    points["intensity"] = np.arange(8)
    path = write_bag(tmp_path, kind, [("/livox/lidar", START, livox(points))])
    source = path if kind == ".bag" else path.parent
    labels = output_path(tmp_path / "out", "drive", "predictions", str(START))
    write_labels(labels, np.full(8, 40, np.uint32))
    export_bag(tmp_path / "out", tmp_path / "to", query=ResultQuery(source / "livox/lidar"))
    new = messages_of(tmp_path / "to" / source.name)[-1]
    assert (new[0], new[1]) == ("/livox/lidar/labelled", START)
    columns = columns_of_fields(new[2], path)
    np.testing.assert_array_equal(columns["x"], points["x"])
    assert columns["reflectivity"].tolist() == list(range(8))
    assert columns["label"].tolist() == [40] * 8


def test_a_topic_that_exists_is_refused_and_the_hint_names_a_free_one(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    call = export(bag, tmp_path)
    caught = refused(OutputError, bag.path, call, topic="/rear")
    assert f'topic="{NEW}_2"' in caught.value.hint
    call(topic=f"{NEW}_2")
    assert f"{NEW}_2" in {message[0] for message in messages_of(tmp_path / "to/drive.bag")}
    with pytest.raises(OutputError, match="topic"):
        call(topic="/other")


def test_files_and_missing_labels_are_refused(tmp_path):
    world = World(tmp_path)
    world.add("000000", None, [40] * 4)
    scan = world.dataset / "sequences/08/velodyne/000000.bin"
    call = partial(export_bag, world.out, tmp_path / "to", query=ResultQuery(world.dataset))
    caught = refused(UsageError, scan, call)
    assert "export-ply" in caught.value.hint
    bag = LabelledBag(tmp_path / "b", ".bag")
    output_path(bag.out, "drive", "predictions", NAMES[1]).unlink()
    refused(NoInputError, bag.path, export(bag, tmp_path))
    assert not (tmp_path / "to/drive.bag").exists()


def test_scans_in_files_beside_bags_are_refused_and_the_hint_exports_the_bags(tmp_path):
    bag = LabelledBag(tmp_path, ".bag")
    file = label_a_file_too(bag, tmp_path / "evening")
    call = partial(export_bag, bag.out, tmp_path / "to", options=STOP)
    caught = refused(UsageError, file, call)
    assert 'sequences=("drive",)' in caught.value.hint
    selected = ResultQuery(selection=ScanSelection(sequences=("drive",)))
    assert call(query=selected).done == 3


def test_both_commands_copy_a_bag_and_the_keys_of_their_results_are_listed(run, tmp_path):
    bag = LabelledBag(tmp_path, ".db3")
    for words in (("export-bag", "--topic", "/new"), ("filter", "--drop", "car")):
        target = tmp_path / words[0]
        call = (words[0], bag.out, target, *words[1:], "--dataset", bag.topic, "--json")
        assert only_json(run(*call, status=0))["done"] == 3
        assert only_json(run(*call, status=0))["skipped"] == 3
        assert {path.name for path in (target / "drive").iterdir()} == {
            "drive.db3",
            "metadata.yaml",
        }
    call = (
        "filter",
        bag.out,
        tmp_path / "to",
        "--drop",
        "car",
        "--dataset",
        bag.topic,
        "--limit",
        1,
    )
    assert "--limit: " in run(*call, status=2).stderr
