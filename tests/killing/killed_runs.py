# SPDX-License-Identifier: MIT
"""Runs that are killed with SIGKILL, begun again, and compared with one that was not.

One process imports torch and forks each run, so that a kill costs tenths of a second and not the
seconds of a cold start. It prints what happened to each job as one JSON list, or fails.

::

    OMP_NUM_THREADS=1 python killed_runs.py FOLDER [JOB:MOMENTS:TIMES ...]

How the moments of the kills are chosen:

random
    At any time while the run lasts, several runs in a folder after each other.
steps
    Before the first, second … time that the run touches its folder, until it is not killed.
group, parent
    With several jobs at any time, the whole group of processes or only the one that leads it.
beside
    Never; two runs fill a folder at once.
"""

import json
import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from whole_files import all_alike, require_whole

Run = Callable[[Path], object]
STEPS = ("open", "os.rename", "os.remove", "os.mkdir", "fcntl.flock")
"""What a run does to files, as Python's audit names it."""


def fork(run: Run, folder: Path, die_at: int = 0) -> int:
    """Start a run in a process of its own, the leader of a new group; return its id.

    Parameters
    ----------
    run : callable
        Is given the folder.
    folder : Path
        Where results go.
    die_at : int
        The step at which it kills itself, from 1; 0 for never.
    """
    process = os.fork()
    if process:
        return process
    os.setsid()
    if die_at:
        _die_at(die_at, folder)
    try:
        run(folder)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def _die_at(step: int, folder: Path) -> None:
    """Kill this process before the step that touches the folder so and so often."""
    seen = 0

    def count(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal seen
        if event in STEPS and (event == "fcntl.flock" or str(folder) in str(arguments[0])):
            seen += 1
            if seen == step:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)


def ended(process: int) -> bool:
    """Wait for a run; return whether it ended by itself, and well."""
    _, status = os.waitpid(process, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise SystemExit("a run failed")
    return os.WIFEXITED(status)


def finish(run: Run, folder: Path) -> float:
    """Run to the end; return the seconds that it took."""
    start = time.monotonic()
    process = fork(run, folder)
    assert ended(process)
    _end_group(process)
    return time.monotonic() - start


def _end_group(leader: int) -> None:
    """End the workers that a run has left behind."""
    try:
        os.killpg(leader, signal.SIGKILL)
    except ProcessLookupError:
        return


def kill(run: Run, folder: Path, seconds: float, moments: str) -> bool:
    """Start a run and kill it after a while; return whether it was killed before it ended."""
    process = fork(run, folder)
    time.sleep(seconds)
    if moments == "group":
        os.killpg(process, signal.SIGKILL)
    else:
        os.kill(process, signal.SIGKILL)
    return not ended(process)


def attack(run: Run, moments: str, kills: int, folder: Path) -> dict[str, object]:
    """Kill runs until they were killed so many times; every few kills let one end, and compare."""
    expected = folder / "expected"
    seconds = finish(run, expected)
    draw = random.Random(f"{moments} {kills}")
    done = finished = unfinished = steps = 0
    while done < kills or moments == "steps":
        out = folder / f"out{finished}"
        for _ in range(draw.randint(1, 3) if moments == "random" else 1):
            if moments == "steps":
                steps += 1
                killed = not ended(fork(run, out, steps))
            else:
                killed = kill(run, out, draw.uniform(0, seconds), moments)
            done += killed
            require_whole(out)
            unfinished += bool(list(out.rglob(".*.part")))
        finish(run, out)
        all_alike(expected, out)
        finished += 1
        if moments == "steps" and not killed:
            break
    return {"kills": done, "finished": finished, "unfinished": unfinished, "seconds": seconds}


def beside(run: Run, times: int, folder: Path) -> dict[str, object]:
    """Let two runs fill one folder at the same time, and compare."""
    expected = folder / "expected"
    finish(run, expected)
    for number in range(times):
        out = folder / f"out{number}"
        processes = [fork(run, out), fork(run, out)]
        ends = [ended(process) for process in processes]
        assert all(ends)
        all_alike(expected, out)
        assert not [path for path in out.rglob(".*") if path.is_file()]
    return {"pairs": times}


def predict_job(folder: Path, jobs: int = 1) -> Run:
    """Return a run of `predict` that writes three files per scan."""
    from scans import write_sequence, write_weights

    from salsanext_cli.inference.settings import NetworkSettings
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.stages.predict import predict_scans

    data = write_sequence(folder / "data/08", ["a", "b", "c"], count=3000)
    network = NetworkSettings(write_weights(folder / "w.safetensors"), "cpu")
    network.load()
    extras, options = ("pixel_labels", "probabilities"), RunOptions(jobs=jobs)

    def run(out: Path, options: RunOptions = options) -> None:
        predict_scans(data, out, network=network, extras=extras, options=options)

    # What is loaded here need not be in every run; one thread, so that forks find no others.
    run(folder / "warm", RunOptions())
    return run


def uncertainty_job(folder: Path) -> Run:
    """Return a run of `uncertainty` that writes six files per scan."""
    from scans import write_sequence, write_weights

    from salsanext_cli.inference.settings import NetworkSettings
    from salsanext_cli.stages.uncertainty import uncertainty
    from salsanext_cli.uncertainty.settings import Estimator

    data = write_sequence(folder / "data/08", ["a", "b", "c"], count=3000)
    network = NetworkSettings(write_weights(folder / "w.safetensors"), "cpu")
    network.load()
    estimator = Estimator(samples=2)

    def run(out: Path) -> None:
        uncertainty(data, out, network=network, estimator=estimator)

    run(folder / "warm")
    return run


def train_job(folder: Path) -> Run:
    """Return a training with a checkpoint after every step, on a clock that stands still."""
    from scans import SMALL, make_scan, write_sequence
    from tiny_network import TinyNetwork

    from salsanext_cli.geometry.knn import knn_refine
    from salsanext_cli.geometry.projection import project
    from salsanext_cli.network.registry import ARCHITECTURES
    from salsanext_cli.stages.train import train
    from salsanext_cli.training import fit as loop
    from salsanext_cli.training.log import draw_curve
    from salsanext_cli.training.recipe import Recipe

    ARCHITECTURES["salsanext"] = TinyNetwork
    loop.SAVE_EVERY = -1.0
    loop.time = SimpleNamespace(monotonic=lambda: 0.0)  # type: ignore[assignment]
    write_sequence(folder / "data/sequences/00", ["0", "1"], count=600)
    write_sequence(folder / "data/sequences/08", ["0"], count=600)
    # Loaded here, so as not to be in every run; but a step would start threads.
    draw_curve(folder / "warm.png", [{"epoch": 1, "loss": 1.0, "miou": 0.5}])
    import_module("torch._dynamo")
    knn_refine(project(make_scan(), SMALL), np.zeros((SMALL.height, SMALL.width), np.uint8))
    recipe = Recipe(epochs=2, batch=1, crop_width=32, samples_per_epoch=4, average=0.5)
    data = folder / "data"
    return lambda run: train(data, run, recipe=recipe, sensor=SMALL, device="cpu")


def overwriting_job(folder: Path) -> Run:
    """Return a run that replaces the results of other settings, and does nothing else."""
    from claiming import claim

    from salsanext_cli.storage.layout import ScanFile
    from salsanext_cli.storage.point_files import write_labels
    from salsanext_cli.storage.stage_records import stage_settings

    scans = [ScanFile("08", stem, folder / f"data/{stem}.bin") for stem in "ab"]
    results = ["sequences/08/predictions/a.label", "sequences/08/predictions/b.label"]

    def run(out: Path) -> None:
        if stage_settings(out, "predict") is None:
            claim(out, "predict", {"weights": 1}, ["predictions"], scans, overwrite=False)
            for result in results:
                write_labels(out / result, np.ones(5, np.uint32))
        claim(out, "predict", {"weights": 2}, ["predictions"], scans[:1], overwrite=True)

    return run


JOBS: dict[str, Callable[[Path], Run]] = {
    "predict": predict_job,
    "predict --jobs 2": lambda folder: predict_job(folder, 2),
    "uncertainty": uncertainty_job,
    "train": train_job,
    "overwriting": overwriting_job,
}


def happened(job: str, folder: Path) -> dict[str, object]:
    """Do what ``JOB:MOMENTS:TIMES`` says, in a folder of its own, and return what happened."""
    name, moments, times = job.split(":")
    folder.mkdir()
    run = JOBS[name](folder)
    if moments == "beside":
        return beside(run, int(times), folder)
    return attack(run, moments, int(times), folder)


def main(folder: str, *jobs: str) -> None:
    """Do one job after the other and print what happened."""
    found = [happened(job, Path(folder) / str(n)) for n, job in enumerate(jobs)]
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
