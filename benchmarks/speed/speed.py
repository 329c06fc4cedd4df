# SPDX-License-Identifier: MIT
"""Time and memory of each part of the method, beside the same method written plainly.

Each turn of each side runs in a process of its own (`speed_turn.py`): the plain side is
`baseline.py`, ours `speed_product.py`; `speed_hardware.py` measures what the machine could do.

Run: python -m benchmarks.speed.speed seq/velodyne [--parts network,predict]
     [--rounds 5] [--passes 1] [--threads 2] [--limit 4] [--weights FILE]
     [--device cpu] [--precision auto] [--engine auto] [--sensor NAME] [--write speed.json]
"""

import argparse
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.speed.speed_hardware import least_seconds
from benchmarks.speed.speed_turn import take_turn
from salsanext_cli.core.engines.device import choose_device, choose_precision
from salsanext_cli.core.engines.registry import choose_engine
from salsanext_cli.core.errors import SalsanextError, UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.json_files import write_json
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.sensors import sensor as find_sensor
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.report.tables import ABSENT, table_of
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import select_scans

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
    weights = network.path
    card = read_card(weights)
    sensor = network.named_sensor() or card.sensor
    _require(weights, card, sensor, parts)
    scans = [
        read_scan(file.path, sensor)
        for file in select_scans(source, selection, card.space)[:rounds]
    ]
    # They are written with the usual columns, and their intensities are divided already.
    sensor_of_scans = replace(sensor, intensity_scale=1.0, columns=())
    device = choose_device(network.device)
    engine = choose_engine(network.engine, device)
    task: dict[str, Any] = {
        "weights": str(weights.resolve()),
        "device": device,
        "precision": choose_precision(network.precision, device, engine),
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
            write_bytes(scan, encode_bin(scans[number % len(scans)]))
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
        sensor.require_noise()
        if not card.architecture.get("dropout", 1):
            hint = "leave uncertainty out of --parts"
            raise WeightsError(weights, "a network without dropout", "one with it", hint)


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


def benchmark_table(found: Mapping[str, Any]) -> Table:
    """Return a table with a row per part of what `benchmark` returns."""
    machine, ceiling, settings = found["machine"], found["ceiling"], found["settings"]
    sensor, precision = settings["sensor"], machine["precision"]
    title = (
        f"{machine['processor']} ({machine['instructions']}), {machine['threads']} threads, "
        f"torch {machine['torch_version']}, {machine['device']}\n"
        f"{sensor['name']}, {sensor['height']}×{sensor['width']}, {precision}; "
        f"{counted(settings['scans'], 'scan')} of {settings['points']:,} points on average"
    )
    notes = (
        f"Medians of {settings['rounds']} rounds, in brackets the lowest and the highest ratio of "
        "a round; of help, CPU time.\n"
        f"Ceiling: {ceiling['operations'] / 1e9:,.0f} GFLOP/s of a matrix product in {precision}, "
        f"{ceiling['bytes'] / 1e9:,.1f} GB/s of a memory copy.\n"
        f"Of the baseline's {settings['samples']} passes, all alike, {settings['passes']} timed."
    )
    rows = []
    for part in found["parts"]:
        ratio, share = part["ratio"], part["share_of_ceiling"]
        sides = [part[side] for side in ("baseline", "product")]
        peaks = [side["peak_bytes"] for side in sides if side]
        rows.append(
            (
                part["part"],
                *(_time(side["median"]) if side else ABSENT for side in sides),
                f"{ratio['median']:.3g} × ({ratio['lowest']:.3g} to {ratio['highest']:.3g})"
                if ratio
                else ABSENT,
                f"{share:.1%}" if share else ABSENT,
                " / ".join(f"{peak / 1e9:.2f}" if peak else ABSENT for peak in peaks),
            )
        )
    headings = ("part", "baseline", "product", "times as fast", "of ceiling", "peak memory, GB")
    return table_of(headings, rows, title=title, caption=escape(notes))


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s " if seconds >= 1 else f"{seconds * 1e3:.3g} ms"


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scans", type=Path)
    parser.add_argument("--parts", default=",".join(PARTS))
    for name, default in (("rounds", 3), ("passes", 1), ("threads", None), ("limit", 4)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--weights", type=Path)
    for name in ("device", "precision", "engine"):
        parser.add_argument(f"--{name}", default="auto")
    parser.add_argument("--sensor", type=find_sensor)
    parser.add_argument("--write", type=Path, help="file for every measurement (.json)")
    given = parser.parse_args(words or None)
    network = NetworkSettings(
        given.weights,
        given.device,
        precision=given.precision,
        engine=given.engine,
        sensor=given.sensor,
        fit=False,
        intensity="raw",
    )
    try:
        found = benchmark(
            given.scans,
            network=network,
            selection=ScanSelection(limit=given.limit),
            parts=[name.strip() for name in given.parts.split(",")],
            rounds=given.rounds,
            passes=given.passes,
            threads=given.threads,
        )
    except SalsanextError as error:
        parser.error(str(error))
    if given.write is not None:
        write_json(given.write, found)
    Console().print(benchmark_table(found))


if __name__ == "__main__":
    main()
