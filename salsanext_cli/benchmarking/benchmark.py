# SPDX-License-Identifier: MIT
"""Time and memory of each part of the method, beside the same method written plainly."""

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from salsanext_cli.benchmarking.hardware import least_seconds
from salsanext_cli.benchmarking.turn import take_turn
from salsanext_cli.engines.device import choose_device, choose_precision
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.normalise import noise_of
from salsanext_cli.network.card import WeightsCard, default_weights, read_card, require_tensors
from salsanext_cli.results.point_files import write_bin
from salsanext_cli.results.selection import ScanSelection, select_scans
from salsanext_cli.sensors.sensor import Sensor

PARTS = ("projection", "network", "knn", "predict", "uncertainty", "confusion", "cold", "help")
SIDES = ("baseline", "product")
SAMPLES = 30
"""Monte-Carlo passes of a scan."""


def benchmark(
    source: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(limit=4),
    parts: Sequence[str] = PARTS,
    rounds: int = 3,
    passes: int = 1,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Measure both sides by turns, each turn in a process of its own, and return plain data.

    `source`, `selection`: the scans; every round takes the next one; `network`: weights of
    SalsaNext, device, sensor, precision and engine; `parts`: some of `PARTS`; `rounds`, `passes`:
    turns of each side at each part, and how many of the baseline's `SAMPLES` passes are timed;
    `threads`: threads of each side; the default of its libraries if not given; `progress`: called
    with the number of parts measured and to be measured.
    """
    if os.name != "posix":
        raise UsageError("benchmark", f"a system of the kind {os.name}", "Linux or macOS")
    if unknown := sorted(set(parts) - set(PARTS)):
        raise UsageError("--parts", ", ".join(unknown), f"some of {', '.join(PARTS)}")
    counts = {"rounds": rounds, "passes": passes, "threads": threads}
    for name, value in counts.items():
        if value is not None and value < 1:
            raise UsageError(f"--{name}", str(value), "at least 1")
    weights = network.weights or default_weights()
    require_tensors(weights)
    card = read_card(weights)
    sensor = network.sensor or card.sensor
    _require(weights, card, sensor, parts)
    scans = [
        read_scan(file.path, sensor)
        for file in select_scans(source, selection, card.space)[:rounds]
    ]
    # They are written with the usual columns, and their intensities are divided already.
    sensor_of_scans = replace(sensor, intensity_scale=1.0, columns=())
    task: dict[str, Any] = {
        "weights": str(weights.resolve()),
        "device": choose_device(network.device),
        "precision": choose_precision(network.precision, choose_device(network.device)),
        "engine": network.engine,
        "sensor": sensor_of_scans.to_dict(),
        "samples": SAMPLES,
        **counts,
    }
    turns: dict[str, Any] = {part: {side: [] for side in SIDES} for part in parts}
    hardware = []
    with tempfile.TemporaryDirectory(prefix="salsanext-") as folder:
        Path(folder, "sensor.toml").write_text(sensor_of_scans.to_toml(), "utf-8")
        for number in range(rounds):
            scan = Path(folder, f"{number:06}.bin")
            write_bin(scan, scans[number % len(scans)])
            hardware.append(take_turn("product", "hardware", task, scan))
            for done, part in enumerate(parts, start=1 + number * len(parts)):
                # Each side begins in every other round; help has no baseline.
                for side in SIDES if number % 2 else reversed(SIDES):
                    if (side, part) != ("baseline", "help"):
                        turns[part][side].append(take_turn(side, part, task, scan))
                if progress:
                    progress(done, rounds * len(parts))
    ceiling = {key: max(each[key] for each in hardware) for key in ("operations", "bytes")}
    points = sum(map(len, scans)) // len(scans)
    least = least_seconds(card.architecture, sensor, points, ceiling)
    return {
        "machine": hardware[0]["machine"],
        "ceiling": ceiling,
        "settings": {**task, "scans": len(scans), "points": points},
        "parts": [_summary(part, turns[part], least.get(part)) for part in parts],
    }


def _require(weights: Path, card: WeightsCard, sensor: Sensor, parts: Sequence[str]) -> None:
    """Refuse a network that the baseline does not have, and uncertainty that is not possible."""
    if (name := card.architecture.get("name")) != "salsanext":
        raise WeightsError(weights, f"architecture {name}", "salsanext, as the baseline has it")
    if "uncertainty" in parts:
        noise_of(sensor)
        if not card.architecture.get("dropout", 1):
            remedy = "leave uncertainty out of --parts"
            raise WeightsError(weights, "a network without dropout", "one with it", remedy)


def _summary(part: str, turns: Mapping[str, Any], least: float | None) -> dict[str, Any]:
    """Return every turn, medians, the ratio and its spread, and the share of the ceiling."""
    found: dict[str, Any] = {"part": part, "ratio": None, "share_of_ceiling": None}
    for side in SIDES:
        seconds, peaks = ([turn[key] for turn in turns[side]] for key in ("seconds", "peak_bytes"))
        peak = max(filter(None, peaks), default=None)
        values = {"seconds": seconds, "peak_bytes": peak}
        found[side] = {"median": median(seconds), **values} if seconds else None
    if found["baseline"]:
        pairs = zip(found["baseline"]["seconds"], found["product"]["seconds"], strict=True)
        ratios = [plain / ours for plain, ours in pairs]
        found["ratio"] = {"median": median(ratios), "lowest": min(ratios), "highest": max(ratios)}
    if least is not None:
        found["share_of_ceiling"] = least / found["product"]["median"]
    return found
