# SPDX-License-Identifier: MIT
"""Captures of UDP packets for tests, and the packets of a VLP-16."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

START_NS = 1_600_000_000_000_000_000
STEP_NS = 1_327_000  # Between two packets of a VLP-16, without the last 104
BLOCKS = 12
CHANNELS = 32  # Of a block: two firings of 16 lasers
ELEVATIONS_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
"""Of the lasers of a VLP-16 in the order of a firing."""
AZIMUTH_STEP_DEG = 0.4  # Between two blocks


@dataclass(frozen=True)
class Sent:
    """Payload of a UDP packet, and where it was sent."""

    payload: bytes
    port: int = 2368
    source: bytes = bytes((192, 168, 1, 201))
    source_port: int = 2368


def write_capture(
    path: Path,
    packets: Iterable[Sent],
    *,
    order: str = "<",
    nanoseconds: bool = False,
    link: int = 1,
    vlan: bool = False,
) -> Path:
    """Write a `.pcap` of packets, `STEP_NS` apart."""
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    content = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    ethernet = bytes(12) + (b"\x81\x00\x00\x05" if vlan else b"") + b"\x08\x00"
    header = {0: bytes(4), 1: ethernet, 101: b"", 113: bytes(14) + b"\x08\x00", 127: b"x"}[link]
    for number, sent in enumerate(packets):
        time = START_NS + number * STEP_NS
        size = len(sent.payload) + 8
        udp = struct.pack(">HHHH", sent.source_port, sent.port, size, 0) + sent.payload
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + size, 0, 0, 64, 17, 0) + sent.source + bytes(4)
        data = header + ip + udp
        part = time % 1_000_000_000 // (1 if nanoseconds else 1000)
        content += struct.pack(order + "IIII", time // 1_000_000_000, part, len(data), len(data))
        content += data
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def vlp16(
    first_azimuth_deg: float, distances: np.ndarray, intensities: np.ndarray, time_us: int = 0
) -> bytes:
    """Return a packet of a VLP-16: distances in metres and intensities in bytes, (12, 32)."""
    payload = b""
    for block in range(BLOCKS):
        azimuth = round(100 * (first_azimuth_deg + block * AZIMUTH_STEP_DEG)) % 36000
        payload += b"\xff\xee" + struct.pack("<H", azimuth)
        for distance, intensity in zip(distances[block], intensities[block], strict=True):
            payload += struct.pack("<HB", round(distance / 0.002), intensity)
    return payload + struct.pack("<IBB", time_us, 0x37, 0x22)


def vlp16_points(
    first_azimuth_deg: float, distances: np.ndarray, intensities: np.ndarray
) -> np.ndarray:
    """Return the points (M, 4) of a packet, x, y, z, intensity, by the manual of the VLP-16.

    The lasers fire every 2.304 µs, and all of them every 55.296 µs; the offsets of the lasers, at
    most 11.2 mm in z, are left out.
    """
    points = []
    for block in range(BLOCKS):
        for channel in range(CHANNELS):
            distance = round(distances[block, channel] / 0.002) * 0.002
            if distance == 0:
                continue
            firing, laser = divmod(channel, 16)
            share = (firing * 55.296 + laser * 2.304) / (2 * 55.296)
            azimuth = np.radians(first_azimuth_deg + (block + share) * AZIMUTH_STEP_DEG)
            elevation = np.radians(ELEVATIONS_DEG[laser])
            flat = distance * np.cos(elevation)
            x = flat * np.cos(azimuth)
            y = -flat * np.sin(azimuth)
            z = distance * np.sin(elevation)
            points.append((x, y, z, intensities[block, channel]))
    return np.array(points)
