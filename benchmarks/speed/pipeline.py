# SPDX-License-Identifier: MIT
"""Time of a scan in a folder, beside that of the network alone on the same scans.

In every round `predict_scans` labels the folder, and the network alone computes the same range
images, so that other work on the machine slows both. The first scans of each are left out: they pay
for loading and compiling.

Run: python -m benchmarks.speed.pipeline velodyne/ [5 weights.safetensors]
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.finished_scans import FinishedScans
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_search import find_scans

LEFT_OUT = 3


def seconds_each(marks: list[float]) -> float:
    """Return the mean time between two scans, without the first ones."""
    return (marks[-1] - marks[LEFT_OUT]) / (len(marks) - 1 - LEFT_OUT)


def main(folder: str, rounds: str = "5", weights: str | None = None) -> None:
    settings = NetworkSettings(Path(weights) if weights else None, "cpu", precision="auto")
    network = settings.load()
    scans = [read_scan(file.path, network.sensor) for file in find_scans(Path(folder))]
    images = [project(scan, network.sensor) for scan in scans]
    times: list[tuple[float, float]] = []
    for number in range(int(rounds)):
        finished = FinishedScans(time.perf_counter)
        options = RunOptions(progress=finished)
        with tempfile.TemporaryDirectory() as out:
            predict_scans(Path(folder), Path(out), settings=settings, options=options)
        alone: list[float] = []
        for image in images:
            network.probabilities(image)
            alone.append(time.perf_counter())
        times.append((seconds_each(finished.readings), seconds_each(alone)))
        each, plain = times[-1]
        print(f"round {number}: {1e3 * each:.1f} ms a scan, network {1e3 * plain:.1f} ms")
    ratios = [each / plain for each, plain in times]
    print(
        f"{len(images)} scans: {statistics.median(ratios):.2f} times the network "
        f"({min(ratios):.2f} to {max(ratios):.2f})"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
