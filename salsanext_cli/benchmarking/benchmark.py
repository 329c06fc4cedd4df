# SPDX-License-Identifier: MIT
"""How fast each part of the method is, beside the same written plainly, in one run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.benchmarking.ceiling import Ceiling, floors
from salsanext_cli.benchmarking.commands import Commands
from salsanext_cli.benchmarking.processes import SIDES, Line, served
from salsanext_cli.benchmarking.result import Benchmark, Measured, Turn
from salsanext_cli.benchmarking.sides import SAMPLES, Task
from salsanext_cli.errors import OutputError, UsageError, WeightsError
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.noise import noise_of
from salsanext_cli.inference.network import choose_device
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.weights import WeightsCard, default_weights, read_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.point_files import write_bin
from salsanext_cli.storage.selection import ScanSelection, select_scans

IN_PROCESS = ("projection", "network", "knn", "predict", "uncertainty", "confusion")
PARTS = (*IN_PROCESS, "cold", "help")
FEWEST = 4
"""Scans of a run of `predict`, of which the first does not count; fewer are repeated."""
MOST = 4
"""Scans that are measured unless more are asked for."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is measured, and how often.

    Attributes
    ----------
    parts : tuple of str
        Of `PARTS`.
    rounds : int
        Turns of each side; in each, every part is measured once on the next scan.
    passes : int
        How many of the baseline's Monte-Carlo passes, which are alike, are timed.
    threads : int, optional
        Of both sides; as many as the libraries take by themselves if not given.
    """

    parts: tuple[str, ...] = PARTS
    rounds: int = 3
    passes: int = 1
    threads: int | None = None

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.parts) - set(PARTS)):
            raise UsageError("--parts", ", ".join(unknown), f"some of {', '.join(PARTS)}")
        for name in ("rounds", "passes", "threads"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise UsageError(f"--{name}", str(value), "at least 1")


def benchmark(
    source: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(limit=MOST),
    plan: Plan = Plan(),
    progress: Progress | None = None,
) -> Benchmark:
    """Measure product and baseline by turns, each in its own process.

    The scans are copied as `.bin` files first, so that both sides read the same.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    network : NetworkChoice
        Weights of SalsaNext, device and sensor.
    selection : Choice
        Which scans.
    plan : Plan
        What is measured.
    progress : callable, optional
        Called with the turns done and to do.

    Raises
    ------
    SalsanextError
        If something cannot be measured at all.
    """
    if os.name != "posix":
        raise UsageError("benchmark", f"a system of the kind {os.name}", "Linux or macOS")
    weights = network.weights or default_weights()
    card = read_card(weights)
    sensor, device = network.sensor or card.sensor, str(choose_device(network.device))
    _require(card, sensor, plan, weights)
    with tempfile.TemporaryDirectory(prefix="salsanext-") as folder:
        scans, out = Path(folder, "scans"), Path(folder, "out")
        points = _copy(select_scans(source, selection, card.space), sensor, scans)
        out.mkdir()
        # The copies hold intensities that are scaled already.
        sensor = replace(sensor, intensity_scale=1.0)
        named = replace(network, weights=weights.resolve(), device=device, sensor=sensor)
        task = Task(named, scans, out, plan.passes)
        commands = Commands(task, card.sensor, plan.threads)
        with served(task, plan.threads) as lines:
            machine, precision = lines["product"].ask("machine"), lines["product"].ask("precision")
            turns = _Turns(lines, commands, find_scans(scans))
            ceiling = Ceiling(precision, 0, 0)
            total = plan.rounds * len(plan.parts)
            for number in range(total):
                if number % len(plan.parts) == 0:
                    ceiling = ceiling.better(lines["product"].ask("ceiling", precision))
                turns.take(plan.parts[number % len(plan.parts)], number // len(plan.parts))
                if progress:
                    progress(number + 1, total)
    lowest = floors(card, sensor, sum(points) // len(points), ceiling)
    settings = {
        "weights": str(weights),
        "sensor": {"name": sensor.name, "height": sensor.height, "width": sensor.width},
        "points": points,
        "rounds": plan.rounds,
        "samples": SAMPLES,
        "baseline_passes_timed": plan.passes,
    }
    return Benchmark(machine, ceiling, settings, turns.measured(lowest))


def require_new(path: Path) -> None:
    """Raise `OutputError` if there is a file of that name, before minutes are spent."""
    if present(path):
        raise OutputError(path, "exists", remedy="use another name, or --overwrite")


def _require(card: WeightsCard, sensor: Sensor, plan: Plan, weights: Path) -> None:
    """Refuse what the baseline does not know, and parts that are not possible."""
    name = card.architecture.get("name")
    if name != "salsanext":
        raise WeightsError(weights, f"architecture {name}", "salsanext, as the baseline has it")
    if "uncertainty" in plan.parts:
        noise_of(sensor)
        if not card.architecture.get("dropout", 1):
            remedy = "leave uncertainty out of --parts"
            raise WeightsError(weights, "a network without dropout", "one with it", remedy)


def _copy(files: Sequence[ScanFile], sensor: Sensor, folder: Path) -> list[int]:
    """Write the scans as `.bin` files, again from the first if they are few; return their sizes."""
    points = []
    for number in range(max(FEWEST, len(files))):
        path = files[number % len(files)].path
        scan = read_scan(path, intensity_scale=sensor.intensity_scale)
        write_bin(folder / f"{number:06}.bin", scan)
        points.append(len(scan))
    return points[: len(files)]


class _Turns:
    """What was measured, by part and side."""

    def __init__(
        self, lines: Mapping[str, Line], commands: Commands, scans: Sequence[ScanFile]
    ) -> None:
        self.lines, self.commands, self.scans = lines, commands, scans
        self.turns: dict[str, dict[str, list[Turn]]] = {}

    def take(self, part: str, number: int) -> None:
        """Let both sides have a turn, each the first in every other round."""
        scan = self.scans[number % len(self.scans)]
        for side in SIDES if number % 2 else reversed(SIDES):
            turns = self.turns.setdefault(part, {side: [] for side in SIDES})[side]
            if part == "cold":
                turns.append(self.commands.cold(side, scan.path))
            elif part != "help":
                turns.append(self.lines[side].ask("turn", part, scan))
            elif side == "product":
                turns.append(self.commands.help())

    def measured(self, floors: Mapping[str, float]) -> tuple[Measured, ...]:
        """Gather the turns of each part."""
        return tuple(
            Measured(part, tuple(turns["baseline"]), tuple(turns["product"]), floors.get(part))
            for part, turns in self.turns.items()
        )
