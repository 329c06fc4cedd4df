# SPDX-License-Identifier: MIT
"""Packets of a network in a capture."""

import pytest
from captures import START_NS, STEP_NS, Sent, write_capture

from salsanext_cli.io.formats.packets import is_cut, udp_packets


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"order": ">"},
        {"nanoseconds": True},
        {"order": ">", "nanoseconds": True},
        {"vlan": True},
        {"link": 0},
        {"link": 101},
        {"link": 113},
    ],
)
def test_packets_of_every_kind_of_capture(tmp_path, options):
    sent = [Sent(bytes([n]) * (10 + n), 100 + n, bytes((10, 0, 0, n)), 200 + n) for n in range(3)]
    path = write_capture(tmp_path / "a.pcap", sent, **options)
    content = path.read_bytes()
    with path.open("rb") as file:
        packets = [*udp_packets(file)]
        assert not is_cut(file)
    for number, (packet, each) in enumerate(zip(packets, sent, strict=True)):
        assert packet.time_ns == START_NS + number * STEP_NS
        assert (packet.source, packet.source_port) == (each.source, each.source_port)
        assert (packet.port, packet.size, packet.payload) == (each.port, 10 + number, each.payload)
        assert content[packet.offset : packet.offset + packet.size] == each.payload
    overhead = len(content) - 24 - sum(len(each.payload) for each in sent)
    lengths = [overhead // 3 + len(each.payload) for each in sent]
    ends = [24, 24 + lengths[0], 24 + sum(lengths[:2]), len(content)]
    for length in sorted({*ends, *range(24, len(content), 7)}):
        path.write_bytes(content[:length])
        with path.open("rb") as file:
            assert len([*udp_packets(file)]) == sum(length >= end for end in ends[1:])
            assert is_cut(file) == (length not in ends)


def test_packets_that_are_no_udp_of_ip_are_skipped(tmp_path):
    path = write_capture(tmp_path / "a.pcap", [Sent(b"abc")], link=127)
    with path.open("rb") as file:
        assert not [*udp_packets(file)]
    for place, value in ((14 + 9, 6), (14, 0x60), (14 + 7, 1)):  # TCP, IPv6, a later fragment
        write_capture(path, [Sent(b"abc"), Sent(b"defg")])
        content = bytearray(path.read_bytes())
        content[24 + 16 + place] = value
        path.write_bytes(content)
        with path.open("rb") as file:
            assert [packet.payload for packet in udp_packets(file)] == [b"defg"]
