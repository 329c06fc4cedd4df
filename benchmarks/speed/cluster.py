# SPDX-License-Identifier: MIT
"""Speed of a run on a Ray cluster, and what its driver costs in time and memory.

The cluster is on this machine: one node of one core for each worker. `predict` labels the scans by
workers of it, and by as many processes, in turns. Then two workers do nothing with many names, if
any are requested.

Run: python -m benchmarks.speed.cluster velodyne/ [2 workers] [3 rounds] [1000000 names, or 0]
"""

import os
import re
import statistics
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from benchmarks.finished_scans import FinishedScans
from benchmarks.processes import ROOT
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.loop.cluster.driver_process import PROGRAM
from salsanext_cli.runs.loop.pool import MAX_CHUNK_SCANS
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile

SMALLER_RUNS = (100, 10)  # Parts of the names, to see how time and memory grow


@contextmanager
def local_cluster(nodes: int) -> Iterator[Any]:
    """Start a cluster of nodes of one core, which find the packages of the checkout."""
    from ray.cluster_utils import Cluster

    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        for _ in range(nodes - 1):
            cluster.add_node(num_cpus=1)
        yield cluster
    finally:
        cluster.shutdown()


def rate(finished: FinishedScans[float]) -> float:
    """Return the scans per second after the first tenth, when all workers have started."""
    start = bisect_left(finished.counts, finished.counts[-1] // 10)
    seconds = finished.readings[-1] - finished.readings[start]
    return (finished.counts[-1] - finished.counts[start]) / seconds


def labelled(scans: Path, **workers: Any) -> tuple[float, float]:
    """Label scans; return the scans per second once started, and the seconds in all."""
    finished = FinishedScans(time.perf_counter)
    options = RunOptions(progress=finished, **workers)
    settings = NetworkSettings(None, "cpu", precision="auto")
    with tempfile.TemporaryDirectory() as out:
        start = time.perf_counter()
        predict_scans(scans, Path(out), settings=settings, options=options)
        return rate(finished), time.perf_counter() - start


def compare(scans: Path, address: str, workers: int, rounds: int) -> None:
    """Print the speed of `predict` by workers of a cluster and by processes, in turns."""
    speeds_by_cluster = []
    speeds_by_jobs = []
    for number in range(rounds):
        by_cluster, cluster_seconds = labelled(scans, cluster=address)
        by_jobs, jobs_seconds = labelled(scans, jobs=workers)
        speeds_by_cluster.append(by_cluster)
        speeds_by_jobs.append(by_jobs)
        print(
            f"round {number}: {by_cluster:.2f} scans/s on the cluster ({cluster_seconds:.1f} s in "
            f"all), {by_jobs:.2f} with --jobs {workers} ({jobs_seconds:.1f} s)",
            flush=True,
        )
    median_by_cluster = statistics.median(speeds_by_cluster)
    median_by_jobs = statistics.median(speeds_by_jobs)
    print(
        f"medians: {median_by_cluster:.2f} scans/s on the cluster, {median_by_jobs:.2f} with "
        f"--jobs {workers}: {median_by_cluster / median_by_jobs:.3f} times its speed"
    )


class PeakOfDriver:
    """Largest memory of the driver process, in MB, read after some of the chunks."""

    def __init__(self) -> None:
        self.megabytes = 0.0
        self.process: Path | None = None

    def read(self) -> None:
        """Find the driver among the processes of this machine, and read its peak."""
        if self.process is None:
            self.process = next(filter(_is_driver, Path("/proc").glob("[0-9]*")), None)
        if self.process is not None:
            self.megabytes = max(self.megabytes, _peak(self.process))


def _is_driver(process: Path) -> bool:
    with suppress(OSError):
        return PROGRAM in (process / "cmdline").read_text()
    return False


def _peak(process: Path) -> float:
    """Return the peak of the resident memory of a process, in MB; 0 if it has ended."""
    with suppress(OSError):
        text = (process / "status").read_text()
        if found := re.search(r"VmHWM:\s+(\d+) kB", text):
            return int(found[1]) / 1e3
    return 0.0


def do_nothing(names: int, address: str) -> None:
    """Send names to workers that do nothing; print what this costs per chunk."""
    scans = [
        ScanFile(sequence=f"{n // 10000:04d}", stem=f"{n:08d}", path=Path(f"/scans/{n:08d}.bin"))
        for n in range(names)
    ]
    before = _peak(Path("/proc/self"))
    driver = PeakOfDriver()
    finished = FinishedScans(time.perf_counter)

    def progress(count: int, total: int) -> None:
        finished(count, total)
        if count % 4096 == 1:
            driver.read()

    start = time.perf_counter()
    run_over_scans(hash, scans, RunOptions(cluster=address, progress=progress))
    seconds = time.perf_counter() - start
    per_chunk = 1e3 * MAX_CHUNK_SCANS / rate(finished)
    print(
        f"{names:9,} names: {seconds:6.1f} s, {per_chunk:.2f} ms per chunk of {MAX_CHUNK_SCANS}; "
        f"driver {driver.megabytes:.0f} MB, main process "
        f"{_peak(Path('/proc/self')) - before:.0f} MB more than its list of names"
    )


def main(scans: str, workers: str = "2", rounds: str = "3", names: str = "1000000") -> None:
    with local_cluster(int(workers)) as cluster:
        if int(rounds):
            compare(Path(scans), cluster.address, int(workers), int(rounds))
        for part in (*SMALLER_RUNS, 1) if int(names) else ():
            do_nothing(int(names) // part, cluster.address)


if __name__ == "__main__":
    main(*sys.argv[1:])
