# SPDX-License-Identifier: MIT
"""Time that the checks of scans, and the fit of sensor and intensity, add to `predict`.

Rounds with and without checks take turns, over the same scans, with the settings that the command
has by default; the first round of each and the first scan of every round are left out. Without
checks a scan is read and projected only. Each scan is compared with itself in the round beside, and
the median of all is printed with the quartiles, since other programs may disturb some. CPU time is
that of all threads, which elapsed time hides where cores are idle. The fit reads up to 16 scans
once per run; its share is of the run over these scans.

Run: python -m benchmarks.speed.checks_cost seq/velodyne [10 weights.safetensors]
"""

import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from benchmarks.finished_scans import FinishedScans
from salsanext_cli.commands.stages import predict
from salsanext_cli.core import labelling
from salsanext_cli.core.checks.scan_checks import UNCHECKED
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.fit import sensor_fit
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

WITH, WITHOUT = "with checks", "without"
Times = npt.NDArray[np.float64]
"""Elapsed and CPU seconds of scans, (N, 2)."""


def times_of(scans: Path, network: NetworkSettings, *, checked: bool) -> tuple[Times, float]:
    """Predict into a new folder; return the times of each scan but the first, and of the fit."""
    fitting: list[float] = []
    fit_scans = sensor_fit.fit_scans

    def timed(*given: Any) -> Network:
        start = time.perf_counter()
        found = fit_scans(*given)
        fitting.append(time.perf_counter() - start)
        return found

    finished = FinishedScans(lambda: (time.perf_counter(), time.process_time()))
    unchecked = patch.object(labelling, "check_scan", lambda *_: UNCHECKED)
    with (
        tempfile.TemporaryDirectory() as out,
        patch.object(sensor_fit, "fit_scans", timed),
        nullcontext() if checked else unchecked,
    ):
        options = RunOptions(progress=finished)
        predict.predict_scans(scans, Path(out), settings=network, options=options)
    return np.diff(finished.readings, axis=0), sum(fitting)


def main(scans: str, rounds: str = "10", weights: str | None = None) -> None:
    own = Path(weights) if weights else None
    network = NetworkSettings(own, precision="auto")
    times: dict[str, list[Times]] = {WITH: [], WITHOUT: []}
    fits: list[float] = []
    for number in range(1 + int(rounds)):
        for name in (WITH, WITHOUT) if number % 2 else (WITHOUT, WITH):
            of_scans, fit = times_of(Path(scans), network, checked=name == WITH)
            if number:
                times[name].append(of_scans)
                fits.append(fit)
    each, plain = np.array(times[WITH]), np.array(times[WITHOUT])
    for name, values in ((WITH, each), (WITHOUT, plain)):
        elapsed, cpu = 1e3 * np.median(values, axis=(0, 1))
        print(f"{name:24} {elapsed:.2f} ms per scan, {cpu:.2f} ms of CPU")
    for number, name in enumerate(("checks, elapsed", "checks, CPU")):
        low, ratio, high = np.quantile((each / plain)[..., number], (0.25, 0.5, 0.75))
        print(f"{name:24} {ratio:.3f} × ({low:.3f} to {high:.3f})")
    fit, count = float(np.median(fits)), plain.shape[1] + 1
    share = fit / (count * np.median(plain[..., 0]))
    print(f"{'fit, once a run':24} {fit:.3f} s, {share:.1%} of {counted(count, 'scan')}")


if __name__ == "__main__":
    main(*sys.argv[1:])
