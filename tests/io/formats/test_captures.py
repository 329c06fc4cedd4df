# SPDX-License-Identifier: MIT
"""Captures of packets: the maker of the sensor, and how to convert those of others."""

import shlex

import pytest
from captures import Sent, write_capture

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.captures import HESAI, LIVOX, OUSTER, ROBOSENSE, VELODYNE, maker_of
from salsanext_cli.runs.scans.scan_search import find_scans


def livox_packet(points: int = 96) -> bytes:
    size = 36 + 14 * points
    return b"\x00" + size.to_bytes(2, "little") + bytes(size - 3)


MAKERS = {
    VELODYNE: [Sent(b"\xff\xee" + bytes(1204)), Sent(bytes(554), 8308)],
    "Velodyne HDL-64": [Sent(b"\xff\xee" + bytes(1204)), Sent(b"\xff\xdd" + bytes(1204))],
    HESAI: [Sent(b"\xee\xff\x01\x04" + bytes(1078)), Sent(b"\xcd\xdc" + bytes(510), 10110)],
    "Hesai Pandar40": [Sent(b"\xff\xee" + bytes(1260))],
    ROBOSENSE: [Sent(bytes.fromhex("55aa050a5aa550a0") + bytes(1240), 6699)],
    "RoboSense M1": [Sent(bytes.fromhex("55aa5aa5") + bytes(1206), 6699)],
    LIVOX: [Sent(livox_packet(), 56301, source_port=56300)],
    "Livox Mid-40": [Sent(b"\x05" + bytes(1361), 60001, source_port=65000)],
    OUSTER: [Sent(bytes(6464), 7502), Sent(bytes(48), 7503)],
}


@pytest.mark.parametrize("name", MAKERS)
def test_the_maker_is_known_by_the_packets(tmp_path, name):
    path = write_capture(tmp_path / "drive.pcap", MAKERS[name] * 3)
    assert maker_of(path) == name.split()[0]
    # Metadata beside it may be of another program.
    (tmp_path / "drive.json").write_text("{}")
    assert maker_of(path) == name.split()[0]


@pytest.mark.parametrize("maker", [HESAI, ROBOSENSE, LIVOX])
def test_captures_of_other_makers_are_named_with_a_program_that_converts_them(tmp_path, maker):
    path = write_capture(tmp_path / "drive.pcap", MAKERS[maker])
    with pytest.raises(FormatError, match=f"capture of a {maker} sensor") as caught:
        find_scans(path)
    assert "LidarView" in caught.value.hint


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty"),
        (b"x" * 500, "not a capture of packets"),
        (b"\x0a\x0d\x0d\x0a" + bytes(500), "format pcapng"),
        ([], "no UDP packets"),
        ([Sent(bytes(700), 5000)], "most packets are of 700 bytes, to port 5000"),
    ],
)
def test_captures_without_a_known_sensor_are_refused_unless_metadata_say_ouster(
    tmp_path, content, problem
):
    path = tmp_path / "drive.pcap"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        write_capture(path, content)
    with pytest.raises(FormatError, match=problem) as caught:
        find_scans(path)
    assert "damaged" not in caught.value.problem
    (tmp_path / "drive_0.json").write_text("{}")
    assert maker_of(path) == OUSTER


def test_the_command_that_converts_a_capture_is_quoted_and_spares_the_capture(tmp_path):
    path = tmp_path / "my drive.pcap"
    path.write_bytes(b"\x0a\x0d\x0d\x0a" + bytes(500))
    with pytest.raises(FormatError) as caught:
        find_scans(path)
    words = shlex.split(caught.value.hint.split("`")[1])
    assert words == ["editcap", "-F", "pcap", str(path), str(tmp_path / "my drive-converted.pcap")]
