# SPDX-License-Identifier: MIT
"""Makers of the sensors whose packets a capture (`.pcap`) contains."""

from collections import Counter
from collections.abc import Callable, Mapping
from glob import escape
from itertools import islice
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.files.reading import reading
from salsanext_cli.io.formats.packets import PCAPNG, UdpPacket, is_capture, udp_packets
from salsanext_cli.io.formats.unread import pcapng_hint

OUSTER = "Ouster"
VELODYNE = "Velodyne"
HESAI = "Hesai"
ROBOSENSE = "RoboSense"
LIVOX = "Livox"
MAX_PACKETS = 5000  # Packets that decide
VELODYNE_BYTES = 1206
BLOCK_STARTS = (b"\xff\xee", b"\xff\xdd")
"""First bytes of a block of the upper and lower lasers of a Velodyne sensor."""
HESAI_PORT = 2368
HESAI_START = b"\xee\xff"  # First bytes of a packet of later models than the Pandar40
OUSTER_PORTS = (7502, 7503)
ROBOSENSE_STARTS = (
    b"\x55\xaa\x05\x0a",
    b"\x55\xaa\x05\x5a",
    b"\xa5\xff\x00\x5a",
    b"\x55\xaa\x5a\xa5",
)
"""First bytes of packets with points or states, of several series."""
LIVOX_PORTS = (*range(56000, 58000), *range(60001, 60010), 65000)
OLD_LIVOX_BYTES = (978, 1278, 1318, 1362)
EXPECTED = "packets of a Velodyne sensor, or of an Ouster sensor with its metadata beside it"
READABLE = (OUSTER, VELODYNE)
LIDARVIEW = "LidarView (lidarview.kitware.com) opens it and saves the frames as .csv"
TOOLS: Mapping[str, str] = {
    HESAI: f"{LIDARVIEW}, and Hesai's ROS driver replays it for a bag",
    ROBOSENSE: f"{LIDARVIEW}, and rslidar_sdk replays it for a bag",
    LIVOX: LIDARVIEW,
}
"""Programs that convert captures of a maker."""


def maker_of(path: Path) -> str:
    """Return the maker of the sensor of most packets of a capture.

    Captures without packets of a known maker are Ouster's if metadata lie beside them.

    Raises
    ------
    FormatError
        If it is no capture, or the maker is unknown.
    """
    has_metadata = any(path.parent.glob(f"{escape(path.stem)}*.json"))
    with reading(path) as file:
        if not is_capture(file) and not has_metadata:
            file.seek(0)
            raise _no_capture_error(path, file.read(4))
        packets = list(islice(udp_packets(file), MAX_PACKETS))
    counts = Counter(filter(None, map(_maker_of_packet, packets)))
    if counts:
        return counts.most_common(1)[0][0]
    if has_metadata:
        return OUSTER
    raise _unknown_maker_error(path, packets)


def readable_maker(path: Path) -> str:
    """Return the maker of a capture; refuse a maker whose packets are not read."""
    maker = maker_of(path)
    if maker not in READABLE:
        problem = f"is a capture of a {maker} sensor, whose packets are not read"
        raise FormatError(path, problem, EXPECTED, TOOLS[maker])
    return maker


def _is_velodyne(packet: UdpPacket) -> bool:
    return packet.size == VELODYNE_BYTES and packet.payload[:2] in BLOCK_STARTS


def _is_hesai(packet: UdpPacket) -> bool:
    # A Pandar40 has blocks like Velodyne's, in packets of another length.
    is_pandar40 = packet.port == HESAI_PORT and packet.payload[:2] == BLOCK_STARTS[0]
    return is_pandar40 or packet.payload.startswith(HESAI_START)


def _is_robosense(packet: UdpPacket) -> bool:
    return packet.payload.startswith(ROBOSENSE_STARTS)


def _is_livox(packet: UdpPacket) -> bool:
    if packet.port not in LIVOX_PORTS and packet.source_port not in LIVOX_PORTS:
        return False
    stated = int.from_bytes(packet.payload[1:3], "little")
    return packet.size in (stated, *OLD_LIVOX_BYTES)


def _is_ouster(packet: UdpPacket) -> bool:
    return packet.port in OUSTER_PORTS


RULES: Mapping[str, Callable[[UdpPacket], bool]] = {
    VELODYNE: _is_velodyne,
    HESAI: _is_hesai,
    ROBOSENSE: _is_robosense,
    LIVOX: _is_livox,
    OUSTER: _is_ouster,
}
"""Tests of a packet by port, length and first bytes; the first that fits counts."""


def _maker_of_packet(packet: UdpPacket) -> str:
    return next((maker for maker, fits in RULES.items() if fits(packet)), "")


def _no_capture_error(path: Path, start: bytes) -> FormatError:
    """Return the error of a file that is no capture, by its first bytes."""
    if start == PCAPNG:
        problem = "is a capture in the format pcapng"
        return FormatError(path, problem, "the format pcap", pcapng_hint(path))
    problem = "is not a capture of packets" if start else "is empty"
    return FormatError(path, problem, EXPECTED)


def _unknown_maker_error(path: Path, packets: list[UdpPacket]) -> FormatError:
    """Return the error of a capture without packets of a known maker."""
    if not packets:
        return FormatError(path, "contains no UDP packets", EXPECTED)
    kinds = Counter((packet.port, packet.size) for packet in packets)
    (port, size), _ = kinds.most_common(1)[0]
    problem = f"is of an unknown sensor: most packets are of {size} bytes, to port {port}"
    hint = "save its clouds as .pcd or .csv with the software of the sensor"
    if size > VELODYNE_BYTES:
        hint += "; for an Ouster sensor, put its metadata beside it, as a .json of the same name"
    return FormatError(path, problem, EXPECTED, hint)
