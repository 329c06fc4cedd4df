# SPDX-License-Identifier: MIT
"""Recordings of an Ouster sensor for tests, written by ouster-sdk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

START, STEP = 1_600_000_000_000_000_000, 100_000_000
"""Time of the first frame, and between two, in nanoseconds."""


def frames(info: Any, count: int, brightest: int) -> Iterator[Any]:
    """Make frames of which every second column measured, at 5 m, 6 m and so on."""
    from ouster.sdk.core import LidarFrame

    for number in range(count):
        frame = LidarFrame(info)
        frame.timestamp[:] = START + number * STEP + np.arange(frame.w) * 1000
        frame.status[:], frame.frame_id = 1, number
        frame.measurement_id[:] = np.arange(frame.w)
        frame.field("RANGE")[:, ::2] = 5000 + number * 1000
        frame.field("REFLECTIVITY")[:] = np.arange(frame.w) % (brightest + 1)
        yield frame


def write_recording(path: Path, count: int, brightest: int = 255) -> Path:
    """Write a `.pcap` with its metadata, or a `.osf`, of 64×512 pixels."""
    from ouster.sdk import osf, pcap
    from ouster.sdk.core import LidarMode, SensorInfo
    from ouster.sdk.util import frame_to_packets

    path.parent.mkdir(parents=True, exist_ok=True)
    info = SensorInfo.from_default(LidarMode._512x10)
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    if path.suffix == ".osf":
        writer = osf.Writer(str(path), info)
        for frame in frames(info, count, brightest):
            writer.save(0, frame, int(frame.timestamp[0]))
        writer.close()
        return path
    packets = []
    for frame in frames(info, count, brightest):
        for number, packet in enumerate(frame_to_packets(frame, info)):
            packet.host_timestamp = int(frame.timestamp[0]) + number * 1_000_000
            packets.append(packet)
    pcap.record(packets, str(path))
    path.with_suffix(".json").write_text(info.to_json_string())
    return path
