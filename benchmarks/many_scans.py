# SPDX-License-Identifier: MIT
"""What each scan costs besides the work on it: finding, claiming, skipping, sending to workers.

The scans and results are empty files in a new folder below the one given. Backends whose package is
not installed can be left out.

Run: python benchmarks/many_scans.py folder/ [20000 loky threading dask ray]
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from salsanext_cli.parallel.run import RunOptions, run_over_scans
from salsanext_cli.parallel.shards import Shard
from salsanext_cli.storage.layout import ScanFile, find_scans, output_path
from salsanext_cli.storage.output_run import claimed

Result = TypeVar("Result")
PER_SEQUENCE = 1000


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
        sequence, scan = divmod(number, PER_SEQUENCE)
        files = (
            data / f"sequences/{sequence:04d}/velodyne/{scan:06d}.bin",
            output_path(out, f"{sequence:04d}", "predictions", f"{scan:06d}"),
        )
        for path in files:
            if scan == 0:
                path.parent.mkdir(parents=True)
            path.write_bytes(b"0")
    return data, out


def claim(out: Path, scans: list[ScanFile]) -> None:
    """Take the output folder, and let it go."""
    with claimed(out, "predict", {"device": "none"}, ("probabilities",), scans, overwrite=False):
        pass


def dispatch(scans: list[ScanFile], backend: str) -> None:
    """Send scans to two workers who do nothing; starting them is left out."""
    marks: list[tuple[int, float]] = []
    options = RunOptions(
        jobs=2, backend=backend, progress=lambda done, _: marks.append((done, time.perf_counter()))
    )
    # Something that every worker has and that takes a scan.
    run_over_scans(hash, scans, options, on_result=lambda _: None)
    (first, start), (last, end) = marks[0], marks[-1]
    print(f"{f'chunks, {backend}':24} {(last - first) / (end - start):7.0f} scans per second")


def main(folder: str, count: str = "20000", *backends: str) -> None:
    number = int(count)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        data, out = fill(Path(made), number)
        scans = timed("find scans", lambda: find_scans(data), number)
        for name in ("claim", "claim again"):
            timed(
                name,
                lambda: claim(out, scans),
                number,
            )
        timed("divide into shards", lambda: Shard(1, 8).of(scans), number)
        timed(
            "skip what is done",
            lambda: run_over_scans(
                hash,
                scans,
                RunOptions(),
                lambda s: [output_path(out, s.sequence, "predictions", s.stem)],
            ),
            number,
        )
        for backend in backends:
            dispatch(scans, backend)


if __name__ == "__main__":
    main(*sys.argv[1:])
