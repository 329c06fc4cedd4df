# SPDX-License-Identifier: MIT
"""Trainings whose device makes the samples from scans in its memory."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from calls import calls_of
from safetensors.torch import load_file
from scans import SMALL, refused, write_sequence

from salsanext_cli.commands.stages.new_training import NewTraining
from salsanext_cli.commands.stages.train import TrainResult, train
from salsanext_cli.core.errors import OutputError, TrainingError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.training import fit
from salsanext_cli.training.data.on_device.batch_maker import BatchMaker
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.distributed import SINGLE_PROCESS
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe, presets, recipe
from salsanext_cli.training.setup import Setup

TINY = Recipe(epochs=2, batch=2, samples_per_epoch=4, crop_width=32, mix=0.5, paste=0.5)
ONCE = TINY.with_changes(epochs=1)

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Three scans to train on and one to score on, by SemanticKITTI's split."""
    write_sequence(tmp_path / "data/sequences/00", ["0", "1", "2"], count=600)
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=600)
    return tmp_path / "data"


def go(dataset: Path, run: Path, recipe: Recipe = TINY, **changes: object) -> TrainResult:
    settings: dict[str, object] = {"sensor": SMALL, "device": "cpu", "samples": "device"}
    return train(dataset, run, recipe=recipe, **(settings | changes))  # type: ignore[arg-type]


def recorded(run: Path) -> str:
    kind: str = json.loads((run / "train.json").read_text())["settings"]["samples"]
    return kind


@pytest.mark.parametrize(
    ("jobs", "workers", "expected"), [(None, "1", 16), (None, "2", 8), (3, "1", 3), (-1, "1", 12)]
)
def test_threads_of_all_cores_read_unless_their_number_is_stated(
    dataset, tmp_path, monkeypatch, jobs, workers, expected
):
    monkeypatch.setattr("salsanext_cli.commands.stages.train.cores", lambda: 16)
    monkeypatch.setattr("salsanext_cli.runs.loop.run_options.cores", lambda: 12)
    monkeypatch.setenv("LOCAL_WORLD_SIZE", workers)
    stores = []

    def end(self, files, validation):
        stores.append(self.store)
        raise KeyboardInterrupt

    monkeypatch.setattr(Setup, "training", end)
    with pytest.raises(KeyboardInterrupt):
        go(dataset, tmp_path / "run", jobs=jobs)
    assert [store.jobs for store in stores] == [expected]


@pytest.mark.parametrize("name", presets())
def test_every_recipe_is_trained(dataset: Path, tmp_path: Path, name: str) -> None:
    small = {"epochs": 1, "batch": 2, "samples_per_epoch": 4, "crop_width": 32, "streets": 0}
    tiny = recipe(name).with_changes(**small, precision="float32", initial="random", folds=0)
    with calls_of(BatchMaker.make) as calls:
        result = go(dataset, tmp_path / "run", tiny)
    assert len(calls) == 2
    assert all(math.isfinite(row["loss"]) and row["miou"] >= 0 for row in result.rows)
    assert recorded(tmp_path / "run") == "device"


class StoppedError(Exception):
    """What stops a training in its midst."""


@pytest.mark.parametrize("stop", [1, 3])
def test_an_interrupted_training_ends_with_the_same_weights(dataset, tmp_path, monkeypatch, stop):
    monkeypatch.setattr(fit, "SAVE_INTERVAL_S", -1.0)

    def interrupt(report: StepReport) -> None:
        if report.step == stop:
            raise StoppedError

    with pytest.raises(StoppedError):
        go(dataset, tmp_path / "parts", progress=interrupt)
    # Without a request, a training is resumed with samples of the same kind.
    parts = go(dataset, tmp_path / "parts", samples="auto")
    whole = go(dataset, tmp_path / "whole")
    one = load_file(whole.last)
    other = load_file(parts.last)
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert [row["loss"] for row in parts.rows] == [row["loss"] for row in whole.rows]


def test_another_kind_of_samples_is_refused(dataset: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    go(dataset, run, ONCE, samples="auto")
    assert recorded(run) == "workers"
    with refused(OutputError, run / "train.json"):
        go(dataset, run, ONCE)
    go(dataset, run, ONCE, overwrite=True)
    assert recorded(run) == "device"
    with refused(OutputError, run / "train.json"):
        go(dataset, run, ONCE, samples="workers")


def test_a_training_of_an_older_version_has_samples_of_workers(dataset, tmp_path):
    run = tmp_path / "run"
    go(dataset, run, ONCE, samples="workers")
    record = json.loads((run / "train.json").read_text())
    del record["settings"]["samples"]
    (run / "train.json").write_text(json.dumps(record))
    go(dataset, run, ONCE, samples="auto")
    with refused(OutputError, run / "train.json"):
        go(dataset, run, ONCE)


@pytest.mark.usefixtures("one_step_fits")
def test_folds_share_the_scans_in_memory(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write_sequence(tmp_path / "data/sequences" / name, ["0"], count=600)
    folds = TINY.with_changes(folds=3, schedule="decay", epochs=1)
    with calls_of(ScanStore._put) as calls:
        go(tmp_path / "data", tmp_path / "run", folds)
    assert len(calls) == 3


def test_a_loss_that_is_not_finite_names_the_scans(dataset, tmp_path, monkeypatch, caplog):
    caplog.set_level(NOTICE)
    monkeypatch.setattr(Learner, "step", lambda *_: torch.tensor(math.nan))
    with refused(TrainingError, "step 1") as caught:
        go(dataset, tmp_path / "run")
    assert str(dataset / "sequences/00/velodyne") in caught.value.problem
    assert caplog.messages[0] == "device: cpu, which also makes the samples"


def test_a_step_without_memory_is_repeated_when_the_device_has_more(dataset, tmp_path, monkeypatch):
    """The scans leave the device once; a further failure is an error."""
    rooms = [True, False]
    failures = [True, False, False, True, True]
    taken = Learner.step

    def step(*arguments: object) -> torch.Tensor:
        if failures.pop(0):
            raise torch.OutOfMemoryError("no room")
        return taken(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Learner, "step", step)
    monkeypatch.setattr(DeviceBatches, "free_device", lambda _: rooms.pop(0))
    with refused(TrainingError, "step 3"):
        go(dataset, tmp_path / "run")
    assert not rooms
    assert failures == [True]


@pytest.mark.parametrize(
    ("samples", "device", "has_room", "expected"),
    [
        ("auto", "cuda", True, "device"),
        ("auto", "cuda", False, "workers"),
        ("auto", "cpu", True, "workers"),
        ("workers", "cuda", True, "workers"),
        ("device", "cpu", False, "device"),
    ],
)
def test_a_gpu_makes_samples_if_there_is_room(tmp_path, samples, device, has_room, expected):
    new = NewTraining(
        roots=(tmp_path,),
        run=tmp_path,
        recipe=TINY,
        weights=None,
        overwrite=False,
        samples=samples,
        jobs=1,
        readers=1,
        group=SINGLE_PROCESS,
        device=torch.device(device),
        tensorboard=False,
    )
    compared: list[object] = []

    def has_room_for(sources: list[object]) -> bool:
        compared.extend(sources)
        return has_room

    room = SimpleNamespace(has_room_for=has_room_for)
    kind = new._kind_of_samples(["training", "validation", "further"], room)  # type: ignore[arg-type]
    assert kind == expected
    assert compared in ([], ["training", "further"])
