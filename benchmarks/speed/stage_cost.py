# SPDX-License-Identifier: MIT
"""Cost of a scan in each stage on one core: CPU time, bytes read and bytes written.

The first scan of each stage is left out, since it pays for loading and compiling. CPU time depends
less than elapsed time on what else the machine does. Bytes are those that pass through system calls
(`/proc/self/io`, Linux only), so nothing that is mapped.

Run: python -m benchmarks.speed.stage_cost dataset/ out/ [30 weights.safetensors]
"""

import statistics
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numba
import torch

from benchmarks.finished_scans import FinishedScans
from salsanext_cli.commands.stages.evaluate import evaluate
from salsanext_cli.commands.stages.export_ply import export_ply
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_selection import ScanSelection


def used() -> tuple[float, int, int]:
    """Return CPU seconds, bytes read and bytes written so far."""
    lines = Path("/proc/self/io").read_text("ascii").splitlines()
    counts = dict(line.split(": ") for line in lines)
    return time.process_time(), int(counts["rchar"]), int(counts["wchar"])


def measure(name: str, stage: Callable[[RunOptions], object]) -> None:
    """Run a stage and print what each scan but the first took."""
    finished = FinishedScans(used)
    stage(RunOptions(progress=finished))
    each = [
        [after - before for after, before in zip(later, earlier, strict=True)]
        for earlier, later in pairwise(finished.readings)
    ]
    cpu, read, written = zip(*each, strict=True)
    megabytes = [statistics.median(values) / 1e6 for values in (read, written)]
    print(
        f"{name:24} {statistics.median(cpu):7.3f} s ({min(cpu):.3f} to {max(cpu):.3f})"
        f"  read {megabytes[0]:5.2f} MB  written {megabytes[1]:5.2f} MB"
    )


def main(dataset: str, out: str, samples: str = "30", weights: str | None = None) -> None:
    data, steps, whole = Path(dataset), Path(out) / "steps", Path(out) / "whole"
    network = NetworkSettings(Path(weights) if weights else None, "cpu")
    sensor = network.load().sensor
    few, method = ScanSelection(limit=4), UncertaintyMethod(samples=int(samples))

    def score(options: RunOptions) -> None:
        evaluate(whole, options=options)

    torch.set_num_threads(1)
    numba.config.NUMBA_NUM_THREADS = 1  # type: ignore[attr-defined]
    measure("project", lambda o: project_scans(data, steps, sensor=sensor, options=o))
    measure(
        "predict, range images",
        lambda o: predict_range_images(steps, steps, settings=network, options=o),
    )
    measure("knn-refine", lambda o: knn_refine_scans(steps, options=o))
    measure("predict, scans", lambda o: predict_scans(data, whole, settings=network, options=o))
    measure("eval", score)
    measure("export-ply", lambda o: export_ply(whole, options=o))
    measure(
        f"uncertainty, {samples} passes",
        lambda o: uncertainty(
            data, whole, settings=network, method=method, selection=few, options=o
        ),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
