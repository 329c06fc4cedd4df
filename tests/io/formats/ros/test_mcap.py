# SPDX-License-Identifier: MIT
"""MCAP files of other systems than ROS 2."""

import struct

import pytest
from scans import refused

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.io.formats.ros.mcap import require_ros2
from salsanext_cli.runs.scans.scan_search import find_scans

pytest.importorskip("rosbags")


def record(kind, content):
    return struct.pack("<BQ", kind, len(content)) + content


def string(text):
    return struct.pack("<I", len(text)) + text.encode()


def other_mcap(profile, schemas):
    """Return an MCAP file without messages: header, summary of schemas, footer."""
    magic = b"\x89MCAP0\r\n"
    start = magic + record(0x01, string(profile) + string("test")) + record(0x0F, bytes(4))
    summary = b"".join(
        record(0x03, struct.pack("<H", number) + string(name) + string("protobuf") + string("x"))
        for number, name in enumerate(schemas, start=1)
    )
    return start + summary + record(0x02, struct.pack("<QQI", len(start), 0, 0)) + magic


@pytest.mark.parametrize(
    ("profile", "schemas", "problem"),
    [
        (
            "",
            ["foxglove.PointCloud"],
            r"is not a recording of ROS 2: contains foxglove\.PointCloud",
        ),
        ("other", [], "is not a recording of ROS 2: has the profile 'other'"),
        ("ros1", ["sensor_msgs/PointCloud2"], "is a recording of ROS 1"),
    ],
)
def test_recordings_of_other_systems_are_named_and_not_called_damaged(
    tmp_path, profile, schemas, problem
):
    path = tmp_path / "drive.mcap"
    path.write_bytes(other_mcap(profile, schemas))
    with pytest.raises(FormatError, match=problem) as caught:
        find_scans(path)
    assert caught.value.hint
    path.write_bytes(other_mcap("ros2", []))
    with pytest.raises(NoInputError, match="no messages"):
        find_scans(path)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"no MCAP file at all, but longer"])
def test_a_file_without_a_readable_header_is_left_to_its_reader(tmp_path, content):
    path = tmp_path / "drive.mcap"
    path.write_bytes(content)
    require_ros2(path)
    path.write_bytes(other_mcap("other", ["a/B"])[:-9])
    refused(FormatError, path, require_ros2, path)
