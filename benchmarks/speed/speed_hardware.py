# SPDX-License-Identifier: MIT
"""Machine of a benchmark, its ceiling, and the least time of each part at it."""

import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from salsanext_cli.core.engines.device import bfloat16_instructions
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.records import CHANNELS
from salsanext_cli.core.sensors.sensor import Sensor

MATRIX_ROWS = {"cpu": 2048, "cuda": 8192}
COPY_BYTES = {"cpu": 1 << 27, "cuda": 1 << 30}  # more than any cache holds
POINT_AND_PIXEL_BYTES = {
    "projection": (16 + 8, 20 + 4),  # coordinates, intensity, pixel, range; channels, point
    "network": (0, 20),
    "knn": (8 + 1, 4 + 1),  # pixel, range, label; range, label
    "predict": (20 + 24 + 9, 24 + 20 + 5),  # both files, and all of these
    "confusion": (1 + 1, 0),
}
"""Bytes of a point and of a pixel that any program reads once or writes once."""


def describe(device: str, precision: str) -> dict[str, Any]:
    """Return what the machine is, and its ceiling: the fastest matrix product and memory copy."""
    cpuinfo, on_gpu = Path("/proc/cpuinfo"), device != "cpu"
    text = cpuinfo.read_text("utf-8") if cpuinfo.exists() else ""
    name = text.partition("model name\t: ")[2].partition("\n")[0]
    kind = device.partition(":")[0]
    rows, size = MATRIX_ROWS[kind], COPY_BYTES[kind]
    matrix = torch.ones(rows, rows, device=device, dtype=getattr(torch, precision))
    source = torch.zeros(size, device=device, dtype=torch.uint8)
    target = torch.empty_like(source)
    wait = torch.cuda.synchronize if on_gpu else tuple
    machine = {
        "processor": name or platform.processor() or platform.machine(),
        "instructions": ", ".join(
            (torch.backends.cpu.get_cpu_capability(), *bfloat16_instructions())
        ),
        "threads": torch.get_num_threads(),
        "torch_version": torch.__version__,
        "device": torch.cuda.get_device_name(device) if on_gpu else "cpu",
        "precision": precision,
    }
    product_s = min(seconds_of(lambda: (matrix @ matrix, wait())))
    copy_s = min(seconds_of(lambda: (target.copy_(source), wait())))
    return {"machine": machine, "operations": 2 * rows**3 / product_s, "bytes": 2 * size / copy_s}


def seconds_of(work: Callable[[], object], repetitions: int = 3) -> list[float]:
    """Return the times of some calls, after one that only warms up."""
    times = []
    for _ in range(1 + repetitions):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return times[1:]


def least_seconds(
    architecture: Mapping[str, Any], sensor: Sensor, points: int, ceiling: Mapping[str, float]
) -> dict[str, float]:
    """Return by part the least time for a scan of so many points at the ceiling, in seconds.

    Only what any program must do is counted: read the input once, write the output once, and
    compute the network's convolutions directly.
    """
    with torch.device("meta"), torch.no_grad(), FlopCounterMode(display=False) as counter:
        image = torch.empty(1, len(CHANNELS), sensor.height, sensor.width)
        build(architecture).eval()(image)
    computing, least = counter.get_total_flops() / ceiling["operations"], {}
    for part, (point, pixel) in POINT_AND_PIXEL_BYTES.items():
        moving = (points * point + sensor.height * sensor.width * pixel) / ceiling["bytes"]
        least[part] = max(moving, computing) if part in ("network", "predict") else moving
    return least
