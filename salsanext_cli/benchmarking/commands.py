# SPDX-License-Identifier: MIT
"""Commands as a user starts them: how long they take, from nothing to their end."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from salsanext_cli.benchmarking.processes import thread_variables
from salsanext_cli.benchmarking.result import Turn
from salsanext_cli.benchmarking.sides import Task, baseline_path
from salsanext_cli.errors import SalsanextError
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.inspect import write_sensor
from salsanext_cli.storage.json_files import write_json

PYTHON = sys.executable
SALSANEXT = (PYTHON, "-m", "salsanext_cli")
UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes in which a system counts the memory of a process."""


class Commands:
    """Both sides' commands for one scan.

    Parameters
    ----------
    task : Task
        What is to be done.
    usual : Sensor
        What the weights take the sensor for; another one is handed over.
    threads : int, optional
        For the libraries of both.
    """

    def __init__(self, task: Task, usual: Sensor, threads: int | None) -> None:
        self.task, self.other = task, task.sensor != usual
        self.environment = {**os.environ, **thread_variables(threads)}
        write_sensor(task.out / "sensor.toml", task.sensor)
        write_json(task.out / "sensor.json", task.sensor.to_dict())

    def cold(self, side: str, scan: Path) -> Turn:
        """Label a scan in a new process; return its seconds by the clock."""
        with tempfile.TemporaryDirectory(dir=self.task.out) as folder:
            command = getattr(self, side)(scan, Path(folder))
            wall, _, peak = run(command, self.environment)
        return Turn(wall, peak)

    def help(self) -> Turn:
        """Ask for help; return the seconds of the processor."""
        _, processor, peak = run((*SALSANEXT, "--help"), self.environment)
        return Turn(processor, peak)

    def baseline(self, scan: Path, out: Path) -> tuple[object, ...]:
        """Return the baseline's command line."""
        sensor = ("--sensor", self.task.out / "sensor.json") if self.other else ()
        network = ("--weights", self.task.weights, "--device", self.task.network.device)
        return PYTHON, baseline_path(), scan, out / "scan.label", *network, *sensor

    def product(self, scan: Path, out: Path) -> tuple[object, ...]:
        """Return the product's command line."""
        sensor = ("--sensor", self.task.out / "sensor.toml") if self.other else ()
        chosen = self.task.network
        network = ("--weights", self.task.weights, "--device", chosen.device)
        precision = ("--precision", chosen.precision)
        return *SALSANEXT, "predict", scan, out, *network, *precision, *sensor, "--quiet"


def run(
    command: Sequence[object], environment: Mapping[str, str]
) -> tuple[float, float, int | None]:
    """Run a command to its end.

    Returns
    -------
    wall, processor : float
        Seconds by the clock, and of all processors.
    peak : int, optional
        Bytes; None for a process smaller than this one, whose memory it starts with.

    Raises
    ------
    SalsanextError
        With the last line that it said, if it fails.
    """
    import resource

    words = [str(word) for word in command]
    with tempfile.TemporaryFile() as said:
        start = time.perf_counter()
        process = subprocess.Popen(words, env=environment, stdout=said, stderr=said)
        try:
            _, status, used = os.wait4(process.pid, 0)
        except KeyboardInterrupt:
            process.kill()
            process.wait()
            raise
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    if process.returncode:
        raise SalsanextError(" ".join(words), lines[-1] if lines else "failed")
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = used.ru_maxrss * UNIT if used.ru_maxrss > own else None
    return wall, used.ru_utime + used.ru_stime, peak
