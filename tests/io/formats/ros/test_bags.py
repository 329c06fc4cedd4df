# SPDX-License-Identifier: MIT
"""Scans of ROS bags that rosbags wrote, and PointCloud2 messages of any layout."""

import sqlite3
import sys

import numpy as np
import pytest
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
    packets,
    structured,
    text,
    write_bag,
)

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, MissingDependency, NoInputError, UsageError
from salsanext_cli.core.optional_packages import extra_command
from salsanext_cli.io.formats.ros.cloud_messages import default_types
from salsanext_cli.runs.scans.scan_search import find_scans

POINTS = [structured(seed=seed) for seed in range(5)]
TIMES = [f"{START + n * STEP}" for n in range(5)]
COMPRESSED = [
    *((".bag", "BZ2"), (".bag", "LZ4"), (".db3", "FILE"), (".db3", "MESSAGE")),
    *((".mcap", "FILE"), (".mcap", "STORAGE")),
]


def require_equal(scan, points):
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(scan.points[:, axis], points[name])
    np.testing.assert_array_equal(scan.intensity, points["intensity"])


@pytest.mark.parametrize(("kind", "compression"), [*((kind, "") for kind in KINDS), *COMPRESSED])
def test_the_scans_are_the_clouds_named_by_their_times(tmp_path, kind, compression):
    others = [("/chatter", START + 1, text), ("/chatter", START + 3 * STEP, text)]
    path = write_bag(tmp_path, kind, [*messages(POINTS), *others], compression=compression)
    sources = [path] if kind == ".bag" else [path.parent] if compression else [path, path.parent]
    for source in sources:
        scans = find_scans(source)
        assert [(scan.sequence, scan.stem) for scan in scans] == [("drive", t) for t in TIMES]
        assert scans[2].path == source / "velodyne_points" / TIMES[2]
        for n in (3, 0, 4, 1, 2):
            require_equal(read_scan(scans[n].path), POINTS[n])
        assert find_scans(scans[3].path) == [scans[3]]


@pytest.mark.parametrize("kind", KINDS)
def test_clouds_of_one_time_are_numbered_in_their_order(tmp_path, kind):
    same = [(TOPIC, START + n // 2, cloud(points)) for n, points in enumerate(POINTS)]
    scans = find_scans(write_bag(tmp_path, kind, same))
    first, second = f"{START}", f"{START + 1}"
    stems = [first, f"{first}_1", second, f"{second}_1", f"{START + 2}"]
    assert [scan.stem for scan in scans] == stems
    for scan, points in zip(scans, POINTS, strict=True):
        require_equal(read_scan(scan.path), points)


def test_a_bag_that_is_replaced_is_opened_again(tmp_path):
    path = write_bag(tmp_path / "a", ".bag", messages(POINTS[:2]))
    (scan, _) = find_scans(path)
    require_equal(read_scan(scan.path), POINTS[0])
    write_bag(tmp_path / "b", ".bag", messages(POINTS[3:])).replace(path)
    require_equal(read_scan(scan.path), POINTS[3])


def test_one_of_several_topics_is_named_the_one_with_most_points_first(tmp_path):
    few = [structured(20, seed) for seed in range(3)]
    none = [structured(0)] * 3
    starting = [structured(0), *POINTS[:2]]  # A driver may begin with an empty cloud.
    written = [
        *messages(none, "/empty"),
        *messages(few, "/clusters"),
        *messages(starting, "/rear/points"),
    ]
    path = write_bag(tmp_path, ".mcap", written)
    listed = (
        r"3 topics .*: /rear/points \(200 points\), /clusters \(20 points\), /empty \(0 points\)"
    )
    with pytest.raises(UsageError, match=listed) as caught:
        find_scans(path)
    assert caught.value.hint == f'choose one with "{path}/rear/points"'
    scans = find_scans(path / "rear/points")
    assert [scan.stem for scan in scans] == TIMES[:3]
    require_equal(read_scan(scans[1].path), POINTS[0])
    for wrong in ("rear", "rear/point", "clusters/1"):
        with pytest.raises(NoInputError, match=r"drive\.mcap"):
            find_scans(path / wrong)


def test_topics_without_clouds_are_named_and_messages_not_yet_in_the_database_missed(tmp_path):
    path = write_bag(tmp_path, ".bag", [("/chatter", START, text)])
    with pytest.raises(NoInputError, match=r"/chatter \(std_msgs/msg/String\)"):
        find_scans(path)
    with pytest.raises(NoInputError, match="no messages"):
        find_scans(write_bag(tmp_path / "empty", ".db3", []))
    path = write_bag(tmp_path, ".db3", messages(POINTS))
    path.with_name("drive.db3-wal").write_bytes(b"pages")
    with pytest.raises(FormatError, match=r"drive\.db3-wal: "):
        find_scans(path)


def test_a_folder_of_bags_asks_for_one(tmp_path):
    path = write_bag(tmp_path, ".bag", messages(POINTS[:1]))
    with pytest.raises(NoInputError) as caught:
        find_scans(tmp_path)
    assert str(path) in caught.value.hint
    write_bag(tmp_path, ".db3", messages(POINTS[:1]))
    exported = tmp_path / "drive" / "scans"
    exported.mkdir()
    refused(NoInputError, exported, find_scans, exported)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_that_was_cut_is_refused(tmp_path, kind):
    points = [structured(2000, seed) for seed in range(12)]
    path = write_bag(tmp_path, kind, messages(points))
    data = path.read_bytes()
    for share in (0, 1, 30, 70, 99):
        path.write_bytes(data[: len(data) * share // 100])
        with pytest.raises(FormatError, match=rf"drive{kind}: ") as caught:
            find_scans(path)
        assert "reindex" in caught.value.hint


def test_damaged_metadata_are_refused_and_the_storage_itself_is_read(tmp_path):
    path = write_bag(tmp_path, ".db3", messages(POINTS))
    metadata = path.with_name("metadata.yaml")
    twice = metadata.read_text().replace("  - drive.db3\n", "  - drive.db3\n" * 2)
    for damaged in ("a: [", "rosbag2_bagfile_information: 3", "", "\0", "{", twice):
        metadata.write_text(damaged)
        with pytest.raises(FormatError, match=r"drive: "):
            find_scans(path.parent)
    assert len(find_scans(path)) == 5


def test_a_database_without_definitions_is_read(tmp_path):
    """As ROS 2 wrote them until 2023."""
    path = write_bag(tmp_path, ".db3", messages(POINTS))
    without_definitions(path)
    require_equal(read_scan(find_scans(path)[1].path), POINTS[1])


def without_definitions(path):
    """Make a database as ROS 2 wrote it until 2023."""
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE schema")
        connection.execute("DROP TABLE message_definitions")
    connection.close()


def test_types_for_bags_without_definitions_are_parsed_once_and_stay_as_they_are(
    tmp_path, monkeypatch
):
    without = write_bag(tmp_path / "without", ".db3", messages(POINTS))
    without_definitions(without)
    own = write_bag(tmp_path / "own", ".db3", messages(POINTS))
    require_equal(read_scan(find_scans(without)[0].path), POINTS[0])
    definitions = dict(default_types().fielddefs)
    monkeypatch.setattr("rosbags.typesys.get_types_from_msg", None)
    for path in (own, without):
        require_equal(read_scan(find_scans(path)[1].path), POINTS[1])
    assert default_types().fielddefs == definitions


def whole_intensities(seed=0):
    points = structured(seed=seed)
    points["intensity"] = np.arange(len(points)) % 256
    return points


@pytest.mark.parametrize("kind", [*KINDS, "without definitions"])
@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
def test_clouds_of_livox_drivers_are_read(tmp_path, kind, package):
    written = [whole_intensities(seed) for seed in range(3)]
    clouds = [("/livox/lidar", START + n, livox(each, package)) for n, each in enumerate(written)]
    path = write_bag(tmp_path, ".db3" if kind not in KINDS else kind, clouds)
    if kind not in KINDS:
        without_definitions(path)
    scans = find_scans(path)
    assert len(scans) == 3
    for file, points in zip(scans, written, strict=True):
        scan = read_scan(file.path)
        for axis, name in enumerate("xyz"):
            np.testing.assert_array_equal(scan.points[:, axis], points[name])
        np.testing.assert_allclose(scan.intensity, points["intensity"] / 255, rtol=1e-6)


def test_clouds_of_channels_are_read_and_refused_with_missing_values(tmp_path):
    path = write_bag(tmp_path, ".bag", [("/cloud", START, channels(POINTS[0]))])
    require_equal(read_scan(find_scans(path)[0].path), POINTS[0])
    path = write_bag(tmp_path / "b", ".bag", [("/cloud", START, channels(POINTS[0], missing=1))])
    with pytest.raises(FormatError, match="channel intensity has 199 values"):
        read_scan(find_scans(path)[0].path)


def test_packets_are_answered_with_a_hint(tmp_path):
    path = write_bag(tmp_path, ".bag", [("/chatter", START, text)])
    with pytest.raises(NoInputError) as caught:
        find_scans(path)
    assert not caught.value.hint
    path = write_bag(tmp_path / "packets", ".bag", [("/velodyne_packets", START, packets)])
    with pytest.raises(NoInputError, match="VelodyneScan") as caught:
        find_scans(path)
    assert "driver" in caught.value.hint


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("several_topics.bag", r"/cluster_markers \(0 points\) \(expected one of them\)"),
        ("foxglove_point_cloud.mcap", r"contains foxglove\.PointCloud"),
    ],
)
def test_reported_bags_are_refused_by_what_they_are(real_data, name, problem):
    with pytest.raises((UsageError, FormatError), match=problem):
        find_scans(real_data / "data/reported/round5/bags" / name)


@pytest.mark.real
@pytest.mark.parametrize("name", ["row_step_of_the_whole_cloud.bag", "livox_custom_msg.bag"])
def test_reported_bags_are_read(real_data, name):
    (file,) = find_scans(real_data / "data/reported/round5/bags" / name)
    scan = read_scan(file.path)
    assert len(scan) > 1000
    assert scan.intensity.max() > 0.1


def test_the_package_that_is_missing_or_too_old_is_named(tmp_path, monkeypatch):
    path = write_bag(tmp_path, ".bag", messages(POINTS[:1]))
    old = tmp_path / "site-packages/rosbags-0.9.23.dist-info"
    old.mkdir(parents=True)
    (old / "METADATA").write_text("Metadata-Version: 2.1\nName: rosbags\nVersion: 0.9.23\n")
    monkeypatch.syspath_prepend(old.parent)
    with pytest.raises(MissingDependency, match=r"0\.9\.23 \(expected 0\.11\.7 or newer"):
        find_scans(path)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingDependency, match="rosbags") as caught:
        find_scans(path)
    assert caught.value.hint == extra_command("ros")
