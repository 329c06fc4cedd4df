# SPDX-License-Identifier: MIT
"""Runs that are killed with SIGKILL at a step, repeated, and compared with a complete run.

As a program, this file imports torch and forks its runs, since a cold start takes seconds. It
prints the numbers of kills, or fails.
"""

import json
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from killing.file_steps import STEPS, at_each_step
from killing.whole_files import require_alike, require_whole

import salsanext_cli

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

Run = Callable[[Path], object]


def fork(run: Run, folder: Path, step: int = 0) -> bool:
    """Run in a fork that is killed at a step, 0 for never; return True if it ended by itself."""
    process = os.fork()
    if not process:
        if step:
            at_each_step(
                str(folder),
                lambda number: number == step and os.kill(os.getpid(), signal.SIGKILL),
                (*STEPS, "os.remove"),
            )
        try:
            run(folder)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(process, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise SystemExit("a run failed")
    return os.WIFEXITED(status)


def kills(run: Run, every: int, folder: Path) -> int:
    """Kill runs at later and later steps, repeat and compare them; return the number of kills.

    The last two parts of their folders are the same, since the page of a training names them.
    """
    expected = folder / "expected/runs/out"
    assert fork(run, expected)
    killed = 0
    while not fork(run, out := folder / f"{killed}/runs/out", (killed + 1) * every):
        require_whole(out)
        assert fork(run, out)
        require_alike(expected, out)
        killed += 1
    return killed


def overwriting(folder: Path) -> Run:
    """Return runs of `predict` that overwrite the results of other settings."""
    from scans import write_sequence, write_weights
    from tiny_network import TinyNetwork

    from salsanext_cli.commands.stages.predict import predict_scans
    from salsanext_cli.core.geometry.knn_parameters import KnnParameters
    from salsanext_cli.core.network.registry import ARCHITECTURES
    from salsanext_cli.runs.loop.run import RunOptions
    from salsanext_cli.runs.network_settings import NetworkSettings

    ARCHITECTURES["salsanext"] = TinyNetwork
    data = write_sequence(folder / "data/08", ["a", "b", "c"], count=3000)
    # OpenVINO's threads do not survive a fork.
    network = NetworkSettings(write_weights(folder / "w.safetensors"), "cpu", engine="torch")
    extras = ("pixel_labels", "probabilities")

    def run(out: Path) -> None:
        if not (out / "predict.json").exists():
            predict_scans(data, out, settings=network, knn=KnnParameters(k=1))
        again = RunOptions(overwrite=True)
        predict_scans(data, out, settings=network, extras=extras, options=again)

    # Load modules here instead of in every fork.
    run(folder / "warm")
    return run


def training(folder: Path) -> Run:
    """Return a training with a checkpoint after every step, and a constant clock."""
    from scans import SMALL, make_scan, write_sequence
    from tiny_network import TinyNetwork

    from salsanext_cli.commands.stages.train import train
    from salsanext_cli.core.geometry.knn import knn_refine
    from salsanext_cli.core.geometry.projection import project
    from salsanext_cli.core.network.registry import ARCHITECTURES
    from salsanext_cli.training import fit
    from salsanext_cli.training.recipe import Recipe

    ARCHITECTURES["salsanext"] = TinyNetwork
    fit.SAVE_INTERVAL_S = -1.0
    fit.time = SimpleNamespace(monotonic=lambda: 0.0)  # type: ignore[assignment]
    write_sequence(folder / "data/sequences/00", ["0", "1"], count=600)
    write_sequence(folder / "data/sequences/08", ["0"], count=600)
    # Load modules here instead of in every fork; a training step would start threads.
    import_module("torch._dynamo")
    knn_refine(project(make_scan(), SMALL), np.zeros((SMALL.height, SMALL.width), np.uint8))
    recipe = Recipe(epochs=2, batch=1, crop_width=32, samples_per_epoch=4, average=0.5)
    data = folder / "data"
    return lambda run: train(data, run, recipe=recipe, sensor=SMALL, device="cpu")


def scenes(folder: Path) -> Run:
    """Return runs of `synth` of two scenes of three points, which overwrite another data set."""
    from salsanext_cli.commands.stages import synth
    from salsanext_cli.core.records import Scan
    from salsanext_cli.synthesis.drive import Frame

    def record(seed: int, sequence: int, scans: int, *_: object) -> Iterator[Frame]:
        scan = Scan(np.full((3, 3), seed, np.float32), np.zeros(3, np.float32))
        for index in range(scans):
            yield Frame(
                scan=scan,
                labels=np.array([40, 40, 10], np.uint32),
                pose=np.eye(4),
                time=float(index),
            )

    synth.record = record  # type: ignore[assignment]
    synth.import_open3d = lambda: None  # type: ignore[assignment,return-value]

    def run(out: Path) -> None:
        if not (out / "synth.json").exists():
            synth.synthesise(out, train=1, valid=0, scans=1, seed=1)
        if json.loads((out / "synth.json").read_text())["settings"]["seed"] == 1:
            synth.synthesise(out, train=1, valid=1, scans=2, overwrite=True)
        # Without --overwrite the run completes the data set.
        synth.synthesise(out, train=1, valid=1, scans=2)

    return run


def bags(folder: Path) -> Run:
    """Return runs of `filter` that write a bag anew."""
    from labelled_bags import LabelledBag

    from salsanext_cli.commands.stages.filter import filter_scans
    from salsanext_cli.runs.loop.run import RunOptions
    from salsanext_cli.runs.results.query import ResultQuery

    bag = LabelledBag(folder, ".mcap")
    query = ResultQuery(bag.topic)
    again = RunOptions(overwrite=True, on_error="stop")

    def run(out: Path) -> None:
        if not (out / "filter.json").exists():
            filter_scans(bag.out, out, drop=["car"], query=query)
        filter_scans(bag.out, out, drop=["car"], query=query, options=again)

    # Load modules here instead of in every fork.
    run(folder / "warm")
    return run


JOBS = {job.__name__: job for job in (overwriting, scenes, training, bags)}


def kills_of(folder: Path, *jobs: str) -> list[int]:
    """Return the numbers of kills of jobs in a new process; ``job:2`` is every second step."""
    here = Path(__file__)
    tests = here.parents[1]
    folders = (Path(salsanext_cli.__file__).parents[1], tests, tests / "helpers", here.parent)
    places = os.pathsep.join(map(str, folders))
    done = subprocess.run(
        [sys.executable, str(here), str(folder), *jobs],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-5000:]
    numbers: list[int] = json.loads(done.stdout.splitlines()[-1])
    return numbers


def test_a_few_kills(tmp_path: Path) -> None:
    overwriting, scenes = kills_of(tmp_path, "overwriting:50", "scenes:25")
    assert overwriting >= 1
    assert scenes >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("job", "every", "kills"),
    [("overwriting", 1, 30), ("scenes", 1, 30), ("training", 4, 30), ("bags", 1, 15)],
)
def test_kills_at_every_step(tmp_path: Path, job: str, every: int, kills: int) -> None:
    """A training has many steps and takes seconds, so every fourth is enough."""
    if job == "bags":
        pytest.importorskip("rosbags")
    (number,) = kills_of(tmp_path, f"{job}:{every}")
    assert number > kills


if __name__ == "__main__":
    # A killed process leaves what it wrote with the system, which need not bring it to the disk.
    os.fsync = os.fstat  # type: ignore[assignment]
    survived = []
    for job in sys.argv[2:]:
        name, every = job.split(":")
        (place := Path(sys.argv[1]) / name).mkdir()
        survived.append(kills(JOBS[name](place), int(every), place))
    sys.stdout.write(json.dumps(survived) + "\n")
