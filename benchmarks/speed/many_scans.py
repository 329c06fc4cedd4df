# SPDX-License-Identifier: MIT
"""Cost of a scan besides the work on it: finding it, recording the run, skipping, sending.

The scans and results are empty files in a new folder below the one given.

Run: python -m benchmarks.speed.many_scans folder/ [20000]
"""

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from benchmarks.finished_scans import FinishedScans
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans

Result = TypeVar("Result")
SCANS_PER_SEQUENCE = 1000


def timed(name: str, work: Callable[[], Result], scans: int) -> Result:
    """Do something and print how long it took, and for each scan."""
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    print(f"{name:24} {seconds:7.3f} s  {1e6 * seconds / scans:6.1f} µs each")
    return result


def fill(folder: Path, count: int) -> tuple[Path, Path]:
    """Make empty scans and results."""
    data, out = folder / "data", folder / "out"
    for number in range(count):
        sequence, scan = divmod(number, SCANS_PER_SEQUENCE)
        files = (
            data / f"sequences/{sequence:04d}/velodyne/{scan:06d}.bin",
            output_path(out, f"{sequence:04d}", "predictions", f"{scan:06d}"),
        )
        for path in files:
            if scan == 0:
                path.parent.mkdir(parents=True)
            path.write_bytes(b"0")
    return data, out


def record(out: Path, scans: list[ScanFile]) -> None:
    """Record a run in the output folder, and end it."""
    with output_run(out, "predict", PredictSettings(), ("probabilities",), scans, overwrite=False):
        pass


def send(scans: list[ScanFile]) -> None:
    """Send scans to two workers that do nothing; starting them is left out."""
    finished = FinishedScans(time.perf_counter)
    options = RunOptions(jobs=2, progress=finished)
    # A function that every worker has and that takes a scan.
    run_over_scans(hash, scans, options)
    later_scans = finished.counts[-1] - finished.counts[0]
    seconds = finished.readings[-1] - finished.readings[0]
    print(f"{'chunks':24} {later_scans / seconds:7.0f} scans per second")


def main(folder: str, count: str = "20000") -> None:
    number = int(count)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        data, out = fill(Path(made), number)
        scans = timed("find scans", lambda: find_scans(data), number)
        for step in ("record the run", "record another run"):
            timed(step, lambda: record(out, scans), number)
        timed("divide into shards", lambda: Shard(1, 8).select(scans), number)
        done = OutputRun(out, folders=("predictions",)).is_done
        skip = partial(run_over_scans, hash, scans, RunOptions(), is_done=done)
        timed("skip what is done", skip, number)
        send(scans)


if __name__ == "__main__":
    main(*sys.argv[1:])
