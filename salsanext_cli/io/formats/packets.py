# SPDX-License-Identifier: MIT
"""UDP packets in captures (`.pcap`), as tcpdump and Wireshark write them."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader

from salsanext_cli.io.files.reading import size_of

FILE_HEADER = 24
RECORD_HEADER = 16
MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""First bytes of a capture: order of its bytes, and nanoseconds per unit of the times."""
PCAPNG = b"\x0a\x0d\x0d\x0a"
"""First bytes of the newer format, which Wireshark writes unless told otherwise."""
ETHERNET = 1
RAW_IP = 101
LINUX_COOKED = 113
LINK_HEADERS = {0: 4, ETHERNET: 14, RAW_IP: 0, LINUX_COOKED: 16}
"""Bytes before the IP header by type of the link."""
VLAN = b"\x81\x00"
UDP = 17


@dataclass(frozen=True, slots=True, kw_only=True)
class UdpPacket:
    """Packet of a capture."""

    time_ns: int
    source: bytes  # IP address
    source_port: int
    port: int
    offset: int  # Of the payload in the file
    size: int  # Bytes of the payload, of which a fragment or a cut packet has fewer
    payload: bytes


def is_capture(file: BufferedReader) -> bool:
    """Return whether a file begins as a capture does."""
    file.seek(0)
    return file.read(4) in MAGICS


def is_cut(file: BufferedReader) -> bool:
    """Return whether a capture ends within a packet."""
    file.seek(0)
    start = file.read(FILE_HEADER)
    if start[:4] not in MAGICS or len(start) < FILE_HEADER:
        return False
    order = MAGICS[start[:4]][0]
    size = size_of(file)
    offset = FILE_HEADER
    while offset < size:
        head = file.read(RECORD_HEADER)
        if len(head) < RECORD_HEADER:
            return True
        (stored,) = struct.unpack_from(order + "I", head, 8)
        offset = file.seek(offset + RECORD_HEADER + stored)
    return offset > size


def udp_packets(file: BufferedReader) -> Iterator[UdpPacket]:
    """Yield the UDP packets of a capture in their order, of fragments only the first.

    A capture of another link than Ethernet, Linux's cooked one or IP yields nothing. The last
    packet is skipped if the file ends within it.
    """
    file.seek(0)
    start = file.read(FILE_HEADER)
    if start[:4] not in MAGICS or len(start) < FILE_HEADER:
        return
    order, unit_ns = MAGICS[start[:4]]
    (link,) = struct.unpack_from(order + "I", start, 20)
    record = struct.Struct(order + "IIII")
    offset = FILE_HEADER
    size = size_of(file)
    while offset + RECORD_HEADER <= size:
        seconds, fraction, stored, _ = record.unpack(file.read(RECORD_HEADER))
        offset += RECORD_HEADER
        if offset + stored > size:
            return
        data = file.read(stored)
        packet = _udp_of(data, offset, link & 0xFFFF, seconds * 1_000_000_000 + fraction * unit_ns)
        if packet:
            yield packet
        offset += stored


def _udp_of(data: bytes, offset: int, link: int, time_ns: int) -> UdpPacket | None:
    """Return the UDP packet in the data of a record at an offset in the file; None for others."""
    if link not in LINK_HEADERS:
        return None
    begin = LINK_HEADERS[link]
    if link == ETHERNET and data[12:14] == VLAN:
        begin += 4
    if len(data) < begin + 28 or data[begin] >> 4 != 4 or data[begin + 9] != UDP:
        return None
    (fragment,) = struct.unpack_from(">H", data, begin + 6)
    if fragment & 0x1FFF:
        return None  # Not the first fragment
    source = data[begin + 12 : begin + 16]
    begin += 4 * (data[begin] & 0x0F)
    if len(data) < begin + 8:
        return None
    source_port, port, length, _ = struct.unpack_from(">HHHH", data, begin)
    payload = data[begin + 8 : begin + max(length, 8)]
    return UdpPacket(
        time_ns=time_ns,
        source=source,
        source_port=source_port,
        port=port,
        offset=offset + begin + 8,
        size=length - 8,
        payload=payload,
    )
