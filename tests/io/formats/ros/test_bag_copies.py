# SPDX-License-Identifier: MIT
"""Copies of bags, compared with the bag by rosbags: everything but the changed clouds is equal."""

import errno
import resource
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scans import refused

pytest.importorskip("rosbags")

from bags import (
    KINDS,
    START,
    STEP,
    TOPIC,
    channels,
    cloud,
    livox,
    messages,
    structured,
    text,
    write_bag,
)
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import Stores, get_typestore

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.bag_index import compression_of, custom_data
from salsanext_cli.io.formats.recordings import files_of
from salsanext_cli.io.formats.ros.bag_copies import CloudChange, copy_bag
from salsanext_cli.io.formats.ros.bags import Bag
from salsanext_cli.io.formats.ros.cloud_messages import POINT_CLOUD2

POINTS = [structured(40, seed) for seed in range(4)]
OTHERS = [("/name", START + 1, text), ("/rear", START + 2, cloud(POINTS[3]))]
COMPRESSED = [
    (".bag", "LZ4"),
    (".mcap", "STORAGE"),
    *(
        pytest.param(kind, compression, marks=pytest.mark.slow)
        for kind, compression in (
            (".bag", "BZ2"),
            (".db3", "FILE"),
            (".db3", "MESSAGE"),
            (".mcap", "FILE"),
            (".mcap", "MESSAGE"),
        )
    ),
]
TIME = QosTime(2, 3)
QOS = Qos(
    QosHistory.KEEP_LAST,
    7,
    QosReliability.BEST_EFFORT,
    QosDurability.TRANSIENT_LOCAL,
    TIME,
    TIME,
    QosLiveliness.AUTOMATIC,
    TIME,
    False,
)
"""Quality of service that differs from the usual one in every field that can."""


def source_of(path):
    """Return the bag of a file that `write_bag` wrote."""
    return path if path.suffix == ".bag" else path.parent


def opened(path):
    return Bag(path, files_of(path))


def recorded(path):
    """Return what rosbags reads: publishers of all topics, and all messages."""
    with AnyReader([path]) as reader:
        publishers = {
            (c.topic, c.msgtype, c.msgdef, c.digest, repr(c.ext)) for c in reader.connections
        }
        return publishers, [(c.topic, time, bytes(raw)) for c, time, raw in reader.messages()]


def emptied(path, message, types):
    """Return a PointCloud2 without its points, as the simplest change."""
    return replace(message, height=1, width=0, row_step=0, data=np.zeros(0, np.uint8))


@pytest.mark.parametrize(("kind", "compression"), [*((kind, "") for kind in KINDS), *COMPRESSED])
def test_all_but_the_changed_clouds_are_equal(tmp_path, kind, compression):
    path = write_bag(tmp_path, kind, [*messages(POINTS[:3]), *OTHERS], compression=compression)
    source = source_of(path)
    target = tmp_path / "new" / source.name
    target.parent.mkdir()
    seen = []

    def new_message(path, message, types):
        seen.append(path)
        return emptied(path, message, types)

    count = copy_bag(
        opened(source), target, {TOPIC: CloudChange(topic=TOPIC, new_message=new_message)}
    )
    assert count == 3
    assert seen == [source / "velodyne_points" / f"{START + n * STEP}" for n in range(3)]
    publishers, old = recorded(source)
    assert recorded(target)[0] == publishers
    for before, after in zip(old, recorded(target)[1], strict=True):
        assert before[:2] == after[:2]
        assert (before[2] == after[2]) == (before[0] != TOPIC)
    assert compression_of(opened(target).reader) == compression


def test_qualities_of_service_publishers_and_texts_of_the_user_stay(tmp_path):
    modern = get_typestore(Stores.ROS2_JAZZY)
    for plugin in rosbag2.StoragePlugin:
        path = tmp_path / plugin.name
        with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
            writer.set_custom_data("weather", "rain")
            first = writer.add_connection(
                "/p", POINT_CLOUD2, typestore=modern, offered_qos_profiles=[QOS]
            )
            writer.add_connection("/never", "std_msgs/msg/Empty", typestore=modern)
            message = cloud(POINTS[0])(modern.types)
            writer.write(first, START, modern.serialize_cdr(message, POINT_CLOUD2))
        target = tmp_path / f"{plugin.name}-new"
        copy_bag(opened(path), target, {})
        assert recorded(target) == recorded(path)
        assert "KEEP_LAST: 1" in str(recorded(target)[0])
        assert custom_data(opened(target).reader) == {"weather": "rain"}
    early = get_typestore(Stores.ROS1_NOETIC)
    path = tmp_path / "two.bag"
    kind = "std_msgs/msg/String"
    with rosbag1.Writer(path) as writer:
        for caller, latching in (("/a", 1), ("/b", None)):
            connection = writer.add_connection(
                "/p", kind, typestore=early, callerid=caller, latching=latching
            )
            writer.write(connection, START, early.serialize_ros1(text(early.types), kind))
    copy_bag(opened(path), tmp_path / "new.bag", {})
    assert recorded(tmp_path / "new.bag") == recorded(path)
    assert "'/a', latching=1" in str(recorded(path)[0])


@pytest.mark.parametrize(
    ("kind", "make"), [*((kind, cloud) for kind in KINDS), (".bag", livox), (".mcap", channels)]
)
def test_a_new_topic_has_clouds_beside_the_old_ones(tmp_path, kind, make):
    path = write_bag(tmp_path, kind, [("/c", START + n, make(POINTS[n])) for n in range(3)])
    source = source_of(path)
    target = tmp_path / "new" / source.name
    target.parent.mkdir()

    def new_message(path, message, types):
        if path.name == f"{START + 1}":
            return None
        new = cloud(POINTS[0])(types)
        return replace(new, header=replace(new.header, frame_id=path.name))

    copy_bag(opened(source), target, {"/c": CloudChange(topic="/d", new_message=new_message)})
    _, old = recorded(source)
    _, new = recorded(target)
    assert [message for message in new if message[0] == "/c"] == old
    with AnyReader([target]) as reader:
        written = [
            (time, reader.deserialize(raw, connection.msgtype))
            for connection, time, raw in reader.messages()
            if connection.topic == "/d"
        ]
    assert [(time, message.header.frame_id) for time, message in written] == [
        (START, f"{START}"),
        (START + 2, f"{START + 2}"),
    ]
    assert written[0][1].data.tobytes() == POINTS[0].tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_clouds_of_one_time_are_named_as_their_scans_are(tmp_path, kind):
    """A mask of one of them must not be applied to the other."""
    same = [(TOPIC, START + n // 2, cloud(points)) for n, points in enumerate(POINTS)]
    source = source_of(write_bag(tmp_path, kind, same))
    bag = opened(source)
    seen = {}

    def new_message(path, message, types):
        seen[path.name] = message.data.tobytes()

    copy_bag(bag, tmp_path / "new.bag", {TOPIC: CloudChange(topic="/new", new_message=new_message)})
    names = [f"{START}", f"{START}_1", f"{START + 1}", f"{START + 1}_1"]
    assert list(seen) == names
    for number, name in enumerate(names):
        columns = bag.columns(TOPIC, START + number // 2, number % 2, source)
        assert np.frombuffer(seen[name], POINTS[0].dtype)["x"].tolist() == columns["x"].tolist()


@pytest.mark.parametrize("kind", [".db3", ".mcap"])
def test_a_bag_of_several_files_becomes_one_file(tmp_path, kind):
    first = write_bag(tmp_path / "a", kind, messages(POINTS[:2]))
    later = [(TOPIC, START + (2 + n) * STEP, cloud(POINTS[2 + n])) for n in range(2)]
    second = write_bag(tmp_path / "b", kind, [*later, ("/name", START + 9 * STEP, text)])
    bag = tmp_path / "drive"
    bag.mkdir()
    parts = [bag / f"drive_{number}{kind}" for number in range(2)]
    for old, new in zip((first, second), parts, strict=True):
        old.rename(new)
    described = yaml.safe_load(second.with_name("metadata.yaml").read_text("utf-8"))
    described["rosbag2_bagfile_information"]["relative_file_paths"] = [part.name for part in parts]
    (bag / "metadata.yaml").write_text(yaml.safe_dump(described), "utf-8")
    target = tmp_path / "new"
    seen = []

    def new_message(path, message, types):
        seen.append(path.name)
        return message

    copy_bag(opened(bag), target, {TOPIC: CloudChange(topic=TOPIC, new_message=new_message)})
    assert seen == [f"{START + n * STEP}" for n in range(4)]
    assert recorded(target) == recorded(bag)
    assert len(recorded(target)[1]) == 5
    names = {path.name for path in target.iterdir()}
    assert names == {f"new{kind}", "metadata.yaml"}


def without_definitions(path):
    """Make a database as ROS 2 wrote it until 2023."""
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("DROP TABLE schema")
        connection.execute("DROP TABLE message_definitions")
        connection.execute("UPDATE topics SET type = 'own_msgs/msg/Own' WHERE name = '/own'")
    connection.close()


def test_a_database_without_definitions_gets_those_of_rosbags(tmp_path):
    path = write_bag(tmp_path / "a", ".db3", messages(POINTS[:2]))
    without_definitions(path)
    bag = opened(path)
    copy_bag(bag, tmp_path / "new", {})
    old = [(c.topic, time, bytes(raw)) for c, time, raw in bag.reader.messages()]
    assert recorded(tmp_path / "new")[1] == old


def test_a_type_without_a_definition_is_copied_but_not_changed(tmp_path, caplog):
    path = write_bag(tmp_path, ".db3", [*messages(POINTS[:1]), ("/own", START, text)])
    without_definitions(path)
    bag = opened(path)
    old = [(c.topic, time, bytes(raw)) for c, time, raw in bag.reader.messages()]
    change = CloudChange(topic=TOPIC, new_message=lambda path, message, types: message)
    copy_bag(bag, tmp_path / "new", {TOPIC: change})
    assert recorded(tmp_path / "new")[1] == old
    (warning,) = caplog.messages
    assert "own_msgs/msg/Own, the type of /own" in warning
    copy_bag(opened(tmp_path / "new"), tmp_path / "third", {TOPIC: change})
    assert recorded(tmp_path / "third")[1] == old
    changes = {"/own": change}
    caught = refused(FormatError, path, copy_bag, bag, tmp_path / "other", changes)
    assert "own_msgs" in caught.value.hint


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_is_an_error_of_the_system(tmp_path, kind):
    many = [structured(400, seed) for seed in range(8)]
    source = source_of(write_bag(tmp_path, kind, messages(many)))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    bag = opened(source)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r".") as caught:
            copy_bag(bag, tmp_path / "new.bag", {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert caught.value.errno in (errno.EFBIG, errno.ENOSPC, errno.EIO)
