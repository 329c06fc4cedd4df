# SPDX-License-Identifier: MIT
"""Speed of whole runs of `predict` on a GPU, from files to label files, while there is time."""

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.finished_scans import FinishedScans
from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_use import mean_text, utilisation
from salsanext_cli.commands.stages.predict import PredictOutcome, predict_scans
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

ENGINE = "torch"  # As the baseline
SECONDS_OF_RUN = 12.0  # Least time that is left for a run
SHARE_OF_RUN = 0.5  # Largest share of the time that is left for the scans of a run
SCANS_OF_WORKER = 256
WORKERS_BY_DEFAULT = 8  # For which a run has scans whose workers are chosen by measurement
FEWEST_SCANS = 8
KIND = "predict, toolkit"  # Calls by which the time of a scan is expected


class TimeOverError(Exception):
    """No time is left for the scans of a run."""


@dataclass(frozen=True, kw_only=True)
class FolderRun:
    """Run of `predict` over a folder: size of the batch and workers, None for the defaults."""

    batch: int | None = None
    jobs: int | None = None

    def name(self, sensor: Sensor) -> str:
        """Return the name of its figures."""
        size = f"{sensor.height}×{sensor.width}"
        return f"{size} predict, --batch {self.batch or 'auto'} --jobs {self.jobs or 'auto'}"


class Countdown(FinishedScans[float]):
    """Progress that notes when scans are finished, and ends a run when the time is over."""

    def __init__(self, figures: Figures) -> None:
        super().__init__(time.monotonic)
        self.figures = figures

    def __call__(self, finished: int, scans: int) -> None:
        """Note the time; raise `TimeOverError` if none is left."""
        super().__call__(finished, scans)
        if self.figures.left() < 0:
            raise TimeOverError


def measure_runs(
    figures: Figures,
    weights: Path,
    sensor: Sensor,
    scans: Sequence[Path],
    runs: Sequence[FolderRun],
    scans_of_worker: int,
) -> None:
    """Measure runs over a folder, in scans a second.

    Parameters
    ----------
    figures : Figures
        Record of the figures.
    weights : Path
        Weights file.
    sensor : Sensor
        Sensor of the scans.
    scans : sequence of Path
        Files of scans, of which a folder has links under many names.
    runs : sequence of FolderRun
        Runs, the most important first.
    scans_of_worker : int
        Most scans for each worker.
    """
    settings = NetworkSettings(
        weights, figures.device, sensor=sensor, precision="auto", engine=ENGINE
    )
    seconds_per_scan = figures.expected(KIND, sensor.height * sensor.width)
    for run in runs:
        name = run.name(sensor)
        if not figures.has_time_for(name, max(SECONDS_OF_RUN, FEWEST_SCANS * seconds_per_scan)):
            continue
        most = scans_of_worker * (run.jobs or WORKERS_BY_DEFAULT)
        affordable = SHARE_OF_RUN * figures.left() / max(seconds_per_scan, 1e-9)
        count = max(FEWEST_SCANS, int(min(most, affordable)))
        with tempfile.TemporaryDirectory(dir=scans[0].parents[1]) as folder:
            for number in range(count):
                os.link(scans[number % len(scans)], Path(folder, f"{number:06}.bin"))
            rate = measure_run(figures, name, settings, Path(folder), run)
        seconds_per_scan = min(seconds_per_scan, 1 / rate) if rate else seconds_per_scan


def measure_run(
    figures: Figures, name: str, settings: NetworkSettings, folder: Path, run: FolderRun
) -> float:
    """Measure a run over a folder; return the scans a second once it has started, 0 if none."""
    finished = Countdown(figures)
    options = RunOptions(jobs=run.jobs, progress=finished)
    outcome: PredictOutcome | None = None
    with tempfile.TemporaryDirectory() as out, utilisation(figures.device) as used:
        start = time.monotonic()
        try:
            outcome = predict_scans(
                folder, Path(out), settings=settings, batch=run.batch, options=options
            )
        except TimeOverError:
            figures.add(f"{name}, scans until the time was over", len(finished.readings))
        elapsed = time.monotonic() - start
    times = finished.readings
    if outcome is not None:
        if outcome.failures:
            raise RuntimeError(f"{name}: {outcome.failures[0].reason}")
        figures.add(f"{name}, workers", outcome.workers or run.jobs or 1)
    figures.add(f"{name}, with its start", len(times) / elapsed, f"scans/s of {len(times)}")
    figures.add(f"{name}, GPU used", mean_text(used), "%")
    warm = len(times) // 4  # Whole batches, which pay for loading the network
    if warm == 0:
        return 0.0
    rate = (len(times) - warm) / max(times[-1] - times[warm - 1], 1e-9)
    figures.add(f"{name}, the later scans", rate, "scans/s")
    return rate
