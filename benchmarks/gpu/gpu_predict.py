# SPDX-License-Identifier: MIT
"""Speed of whole runs of `predict` on a GPU, from files to label files, while there is time."""

import math
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.finished_scans import FinishedScans
from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_use import mean_text, utilisation
from benchmarks.gpu.time_limit import TimeOverError
from salsanext_cli.commands.stages.predict import PredictOutcome, predict_scans
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.loop.measured_workers import FIRST_SCANS
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

ENGINE = "torch"  # As the baseline
SECONDS_OF_RUN = 12.0  # Least time that is left for a run
SHARE_OF_RUN = 0.5  # Largest share of the time that is left for the scans of a run
SCANS_OF_WORKER = 256
WORKERS_BY_DEFAULT = 8  # For which a run has scans whose workers are chosen by measurement
WARM_SHARE = 4  # One of so many scans is not counted, since the network is loaded meanwhile
FEWEST_SCANS = 8
KIND = "predict, toolkit"  # Calls by which the time of a scan is expected


@dataclass(frozen=True, kw_only=True)
class FolderRun:
    """Run of `predict` over a folder.

    Attributes
    ----------
    batch : int, optional
        Scans of a batch; None for the default.
    jobs : int, optional
        Workers; None for the default.
    most_seconds : float
        Seconds after which the run is ended.
    """

    batch: int | None = None
    jobs: int | None = None
    most_seconds: float = math.inf

    def name(self, sensor: Sensor) -> str:
        """Return the name of its figures."""
        size = f"{sensor.height}×{sensor.width}"
        return f"{size} predict, --batch {self.batch or 'auto'} --jobs {self.jobs or 'auto'}"


class Countdown(FinishedScans[float]):
    """Progress that notes when scans are finished, and ends a run when the time is over.

    Parameters
    ----------
    end : float
        End of the time, by `time.monotonic`.
    """

    def __init__(self, end: float) -> None:
        super().__init__(time.monotonic)
        self.end = end

    def __call__(self, finished: int, scans: int) -> None:
        """Note the time; raise `TimeOverError` if none is left."""
        super().__call__(finished, scans)
        if time.monotonic() > self.end:
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
    end = min(figures.deadline, time.monotonic() + run.most_seconds)
    finished = Countdown(end)
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
    warm = len(times) // WARM_SHARE  # Whole batches
    if outcome is not None and outcome.workers:
        warm = FIRST_SCANS + 1  # The first scan of the workers tells that they have started.
        start_s = times[FIRST_SCANS] - times[FIRST_SCANS - 1]
        figures.add(f"{name}, start of the workers", start_s, "s")
    if warm == 0:
        return 0.0
    rate = rate_after(times, warm)
    figures.add(f"{name}, the later scans", rate, "scans/s")
    return rate


def rate_after(times: Sequence[float], warm: int) -> float:
    """Return the scans a second after some that warm up, by the times of all in seconds."""
    return (len(times) - warm) / max(times[-1] - times[warm - 1], 1e-9)
