# SPDX-License-Identifier: MIT
"""One turn of one side of a benchmark: its process, and the program that runs there."""

import importlib
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from subprocess import PIPE, Popen
from typing import Any

import torch

from benchmarks.processes import script_command, script_environment
from benchmarks.speed.speed_hardware import seconds_of
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.runs.loop.pool import end_with_parent

REPETITIONS = {"projection": 20, "network": 5, "knn": 20, "predict": 5, "confusion": 20}
"""Calls of a part, of which the median counts; one if not listed."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MAXRSS_UNIT_BYTES = 1 if sys.platform == "darwin" else 1024


def take_turn(side: str, part: str, task: Mapping[str, Any], scan: Path) -> dict[str, Any]:
    """Measure a part for one scan in a new process.

    Returns ``seconds``: of "cold" from start to end of the process, of "help" its CPU time.
    ``peak_bytes``: of the GPU if it is used, else of the process; None for one smaller than this
    one, because the system counts a new process with the memory of its parent.
    """
    import resource  # not on Windows

    threads = dict.fromkeys(THREAD_VARIABLES, str(task["threads"])) if task["threads"] else {}
    command = _command(side, part, task, scan)
    environment = {**script_environment(), **threads}
    start = time.perf_counter()
    # In a group of its own it is not interrupted by Ctrl-C, but killed.
    with Popen(command, env=environment, stdout=PIPE, process_group=0) as process:
        try:
            printed = process.stdout.read()  # type: ignore[union-attr]
            _, status, used = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            raise
        process.returncode = os.waitstatus_to_exitcode(status)
    elapsed, cpu = time.perf_counter() - start, used.ru_utime + used.ru_stime
    if process.returncode:
        found = f"its process ended with status {process.returncode}"
        hint = "see what it wrote, and whether there was memory for it"
        raise SalsanextError(f"benchmark, {side} {part}", found, hint=hint)
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = used.ru_maxrss * MAXRSS_UNIT_BYTES if used.ru_maxrss > own else None
    measured = {} if part in ("cold", "help") else json.loads(printed)
    return {"seconds": cpu if part == "help" else elapsed, "peak_bytes": peak, **measured}


def _command(side: str, part: str, task: Mapping[str, Any], scan: Path) -> list[str]:
    """Return the command that a user would type, or that runs `main`."""
    if part == "help":
        return script_command("salsanext_cli", "--help")
    if part != "cold":
        settings = json.dumps({**task, "parent": os.getpid()})
        return script_command("benchmarks.speed.speed_turn", side, part, settings, scan)
    options = ["--weights", task["weights"], "--device", task["device"]]
    options += ["--sensor", scan.with_name("sensor.toml")]
    if side == "baseline":
        out = scan.with_suffix(".label")
        return script_command("benchmarks.speed.baseline", scan, out, *options)
    options += ["--precision", task["precision"], "--engine", task["engine"], "--quiet"]
    return script_command("salsanext_cli", "predict", scan, scan.with_suffix(".out"), *options)


def main(side: str, part: str, task: str, scan: str) -> None:
    """Measure a part for one scan and print the result as JSON."""
    settings, repetitions = json.loads(task), REPETITIONS.get(part, 1)
    end_with_parent(settings["parent"])
    # Ours is not imported for the baseline, whose memory it would add to.
    module = "baseline" if side == "baseline" else "speed_product"
    prepare = importlib.import_module(f"benchmarks.speed.{module}").prepare
    work = prepare(part, Path(scan), settings)
    found = work() if part == "hardware" else {"seconds": median(seconds_of(work, repetitions))}
    if (side, part) == ("baseline", "uncertainty"):
        found["seconds"] *= settings["samples"] / settings["passes"]
    if settings["device"] != "cpu":
        found["peak_bytes"] = torch.cuda.max_memory_allocated()
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
