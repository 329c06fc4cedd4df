# SPDX-License-Identifier: MIT
import json
import math
import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from calls import calls_of
from safetensors.torch import load_file
from scans import SMALL, write_sequence
from shallow_network import SHALLOW
from tiny_network import TinyNetwork

from salsanext_cli import LabelSpace, label_space, load_network, project, read_scan, write_labels
from salsanext_cli.commands.stages.train import train
from salsanext_cli.core.errors import (
    LabelError,
    NoInputError,
    OutputError,
    TrainingError,
    UsageError,
    WeightsError,
)
from salsanext_cli.core.geometry.intensity import intensity_quantiles
from salsanext_cli.core.geometry.row_gaps import row_gaps
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training import fit, learner
from salsanext_cli.training.data import reading_progress
from salsanext_cli.training.data.class_counts import class_weights
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.distributed import SINGLE_PROCESS
from salsanext_cli.training.fit import Training
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.memory import Memory
from salsanext_cli.training.recipe import Recipe, recipe
from salsanext_cli.training.run_folder import resumption
from salsanext_cli.training.scoring.validation import validate
from salsanext_cli.training.setup import Setup

TINY = Recipe(
    epochs=2,
    batch=2,
    crop_width=32,
    optimiser="adamw",
    learning_rate=1e-3,
    schedule="one-cycle",
    average=0.5,
)

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture
def dataset(tmp_path):
    """Three scans to train on and two to score on, by SemanticKITTI's split."""
    root = tmp_path / "data"
    write_sequence(root / "sequences" / "00", ["0", "1", "2"], count=600)
    write_sequence(root / "sequences" / "08", ["0", "1"], count=600)
    return root


def go(dataset, run, **changes):
    given = {"recipe": TINY, "sensor": SMALL, "device": "cpu"}
    return train(dataset, run, **{**given, **changes})


def no_step(report):
    raise AssertionError("a step was taken")


def refused(error, subject, dataset, run, **changes):
    """Return an error that a training ends with before its first step."""
    with pytest.raises(error) as caught:
        go(dataset, run, progress=no_step, **changes)
    assert caught.value.subject == str(subject)
    return caught.value


def same(one, other):
    a, b = load_file(one), load_file(other)
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


def test_a_run_folder_holds_weights_log_and_recipe(dataset, tmp_path):
    reports = []
    run = tmp_path / "run"
    result = go(dataset, run, progress=reports.append)
    shown = {path.name for path in run.iterdir() if not path.name.startswith(".")}
    weights = {"best.safetensors", "last.safetensors", "checkpoint.safetensors"}
    records = {"class_counts.json", "train.json", "recipe.toml", "log.csv"}
    pictures = {"curve.png", "samples.png", "training.html"}
    assert shown == weights | records | pictures
    assert recipe(run / "recipe.toml") == TINY
    assert len((run / "log.csv").read_text().splitlines()) == 1 + TINY.epochs
    # Three scans in batches of two: the second batch of an epoch goes on with the next round.
    assert [report.step for report in reports] == list(range(1, 5))
    assert [report.row is not None for report in reports] == [False, True] * 2
    assert [report.epoch for report in reports] == [1, 1, 2, 2]
    assert result.best_miou == max(row["miou"] for row in result.rows)
    card = read_card(run / "best.safetensors")
    assert card.recipe == TINY.to_dict()
    scans = sorted(dataset.glob("sequences/00/*/*.bin"))
    images = [project(read_scan(scan), SMALL).channels for scan in scans]
    quantiles, gaps = intensity_quantiles(images), row_gaps(images)
    assert card.sensor == replace(SMALL, intensity_quantiles=quantiles, row_gaps=gaps)
    assert card.scores["miou"] == result.best_miou
    # A finished training has nothing left to do.
    assert go(dataset, run, progress=no_step) == result


def test_the_beginning_states_device_scans_and_images(dataset, tmp_path, caplog):
    caplog.set_level(NOTICE)
    go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1))
    lines = [text for text in caplog.messages if not text.startswith("field of view")]
    assert lines[0].startswith("device: cpu")
    assert "3 scans for training, 2 for validation; an epoch has 4 images of 16×32" in lines[1]
    assert lines[2].startswith("reading 5 scans")
    assert lines[3].endswith("the first step begins")


def test_reading_many_scans_is_reported_from_time_to_time(dataset, tmp_path, monkeypatch, caplog):
    caplog.set_level(NOTICE)
    clock = iter(range(0, 10**6, 20))
    monkeypatch.setattr(reading_progress, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1))
    # Every scan takes 20 seconds: two validation scans, then three of training.
    lines = [text for text in caplog.messages if text.endswith(" left")]
    assert lines == ["2 of 2 scans read, about 0 s left", "2 of 3 scans read, about 20 s left"]


def test_a_step_that_needs_more_than_the_machine_has_is_refused(dataset, tmp_path, monkeypatch):
    memory = Memory(total=12 * 10**6, available=12 * 10**6)
    monkeypatch.setattr("salsanext_cli.training.preconditions.memory_of", lambda device: memory)
    run = tmp_path / "run"
    error = refused(TrainingError, "memory", dataset, run)
    assert error.hint.startswith("use accumulate=2 ")
    assert not (run / "train.json").exists()
    fitting = TINY.with_changes(accumulate=2, epochs=1)
    go(dataset, run, recipe=fitting)


def test_an_interrupted_training_states_from_where_it_resumes(dataset, tmp_path):
    run = tmp_path / "run"
    assert "starts again" in resumption(run)
    go(dataset, run, recipe=TINY.with_changes(epochs=1))
    assert "resumes from the last checkpoint" in resumption(run)


def test_a_training_at_several_widths_scores_each_and_is_for_the_first(dataset, tmp_path):
    mixed = TINY.with_changes(epochs=1, widths="64,128")
    result = go(dataset, tmp_path / "run", recipe=mixed)
    card = read_card(result.last)
    assert card.sensor.resized(width=SMALL.width).view() == SMALL.view()
    assert card.sensor.width == 64
    (row,) = result.rows
    again = load_network(result.last, "cpu", engine="torch")
    scored = Source(
        files=find_scans(dataset / "sequences" / "08"), space=again.space, sensor=again.sensor
    )
    for width, suffix in ((64, ""), (128, "_128")):
        measured, _ = validate(again, scored.at_width(width))
        for name in ("accuracy", "miou"):
            assert row[name + suffix] == pytest.approx(measured[name], abs=1e-6)


def test_finished_weights_have_the_ranges_of_int8(dataset, tmp_path, monkeypatch):
    monkeypatch.setitem(ARCHITECTURES, "salsanext", partial(SalsaNext, **SHALLOW))
    result = go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1))
    last, best = (read_card(path).int8 for path in (result.last, result.best))
    assert last == best
    assert {"block1.stack.fuse.0", "up1.stack.fuse.0"} <= last.keys()
    assert go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1)) == result


class Stopped(BaseException):
    """Ctrl-C at a chosen step."""


def stop_at(dataset, run, step, **changes):
    """Begin a training and interrupt it after a step."""

    def interrupt(report):
        if report.step == step:
            raise Stopped

    with pytest.raises(Stopped):
        go(dataset, run, progress=interrupt, **changes)


def require_same(whole, parts):
    assert same(whole.last, parts.last)
    assert same(whole.best, parts.best)
    assert [row["loss"] for row in whole.rows] == [row["loss"] for row in parts.rows]
    assert parts.best_miou == whole.best_miou


@pytest.mark.parametrize(("stop", "jobs"), [(2, 1), pytest.param(3, 2, marks=pytest.mark.slow)])
def test_an_interrupted_training_ends_with_the_same_weights(dataset, tmp_path, stop, jobs):
    stop_at(dataset, tmp_path / "parts", stop)
    steps = []
    parts = go(dataset, tmp_path / "parts", jobs=jobs, progress=lambda r: steps.append(r.step))
    # Progress is reported after an epoch is on disk, so that stopping at 2 loses nothing.
    assert steps[0] == stop // 2 * 2 + 1
    require_same(go(dataset, tmp_path / "whole"), parts)


CHANGES = ("mix", "paste", "intensity", "mount", "view", "fewer_beams", "jitter", "holes")
OTHERWISE = dict.fromkeys(CHANGES, 0.5) | {"sensors": "fitted", "no_intensity": 0.3}


@pytest.mark.parametrize(
    ("stop", "changes"),
    [
        (1, {"accumulate": 2, "clip_gradient": 0.5, "precision": "float16"}),
        (4, {"precision": "bfloat16", "samples_per_epoch": 8, **OTHERWISE}),
    ],
)
def test_it_goes_on_at_a_step_within_an_epoch(dataset, tmp_path, monkeypatch, stop, changes):
    monkeypatch.setattr(fit, "SAVE_INTERVAL_S", -1.0)
    wanted = {"recipe": TINY.with_changes(epochs=2, samples_per_epoch=6).with_changes(**changes)}
    stop_at(dataset, tmp_path / "parts", stop, **wanted)
    steps = []
    parts = go(dataset, tmp_path / "parts", progress=lambda r: steps.append(r.step), **wanted)
    assert steps[0] == stop + 1
    require_same(go(dataset, tmp_path / "whole", **wanted), parts)


def test_another_network_by_its_name(dataset, tmp_path, monkeypatch):
    other = partial(SalsaNext, context_width=4, widths=(4, 8), decoder_widths=(4,))
    monkeypatch.setitem(ARCHITECTURES, "other", other)
    rung = {"recipe": TINY.with_changes(epochs=1, architecture="other")}
    first = go(dataset, tmp_path / "first", **rung)
    network = load_network(first.best, "cpu")
    assert network.card.architecture["name"] == "other"
    assert network.card.space.fits(label_space())
    assert recipe(tmp_path / "first/recipe.toml").architecture == "other"
    with pytest.raises(WeightsError, match='set architecture = "other" in the recipe'):
        go(dataset, tmp_path / "second", weights=first.best)
    with pytest.raises(UsageError, match=r"unknown architecture resnet"):
        go(dataset, tmp_path / "second", recipe=TINY.with_changes(architecture="resnet"))
    assert not (tmp_path / "second").exists()


def test_another_recipe_is_refused_and_overwrite_starts_again(dataset, tmp_path):
    run, fewer = tmp_path / "run", TINY.with_changes(epochs=1)
    go(dataset, run)
    error = refused(OutputError, run / "train.json", dataset, run, recipe=fewer)
    assert "recipe.epochs was 2 and is 1" in str(error)
    again = go(dataset, run, recipe=fewer, overwrite=True)
    assert len(again.rows) == 1
    assert same(again.last, go(dataset, tmp_path / "other", recipe=fewer).last)


def test_another_cpu_resumes_in_the_precision_of_the_first(dataset, tmp_path, monkeypatch):
    wanted = TINY.with_changes(epochs=1, precision="auto")
    monkeypatch.setattr(learner, "bfloat16_instructions", lambda: ["bf16"])
    first = go(dataset, tmp_path / "run", recipe=wanted)
    assert recipe(tmp_path / "run/recipe.toml") == wanted.with_changes(precision="bfloat16")
    monkeypatch.setattr(learner, "bfloat16_instructions", list)
    assert go(dataset, tmp_path / "run", recipe=wanted) == first
    other = wanted.with_changes(precision="float16")
    refused(OutputError, tmp_path / "run/train.json", dataset, tmp_path / "run", recipe=other)


def test_labels_edited_since_they_were_counted_are_counted_again(dataset, tmp_path):
    recipe = TINY.with_changes(epochs=1)
    go(dataset, tmp_path / "run", recipe=recipe)
    counted = tmp_path / "run" / "class_counts.json"
    before = counted.read_bytes()
    path = dataset / "sequences" / "00" / "labels" / "1.label"
    write_labels(path, np.full(600, 40, np.uint32))
    go(dataset, tmp_path / "run", recipe=recipe)
    roads = [json.loads(text)["points"]["road"] for text in (before, counted.read_text())]
    assert roads[1] > roads[0] + 300
    write_labels(path, np.full(600, 77, np.uint32))
    refused(LabelError, path, dataset, tmp_path / "run", recipe=recipe)


def test_a_key_that_is_not_recorded_was_the_default(dataset, tmp_path):
    run, once = tmp_path / "run", TINY.with_changes(epochs=1)
    result = go(dataset, run, recipe=once)
    path = run / "train.json"
    manifest = json.loads(path.read_text("utf-8"))
    recorded = manifest["settings"]["recipe"]
    del recorded["mix"], recorded["paste"]
    path.write_text(json.dumps(manifest), "utf-8")
    refused(OutputError, path, dataset, run, recipe=once.with_changes(mix=0.5))
    assert go(dataset, run, recipe=once) == result


def test_the_recipe_of_a_run_resumes_it_unless_it_was_edited(dataset, tmp_path):
    """The parts of a batch may change, as they must when there is no memory left."""
    run, steps, halves = tmp_path / "run", [], TINY.with_changes(accumulate=2)
    stop_at(dataset, run, 3)
    go(dataset, run, recipe=halves, progress=lambda r: steps.append(r.step))
    assert steps[0] == 3
    assert recipe(run / "recipe.toml") == halves
    go(dataset, run, recipe=recipe(run / "recipe.toml"), progress=no_step)
    text = "# shorter\n" + TINY.with_changes(epochs=1).to_toml()
    (run / "recipe.toml").write_text(text, "utf-8")
    edited = {"recipe": recipe(run / "recipe.toml"), "overwrite": True}
    refused(OutputError, run / "recipe.toml", dataset, run, **edited)
    assert (run / "recipe.toml").read_text("utf-8") == text


def test_more_epochs_give_the_weights_of_an_uninterrupted_training(dataset, tmp_path, caplog):
    run, steps, steady = tmp_path / "run", [], TINY.with_changes(schedule="decay")
    caplog.set_level("DEBUG", "salsanext_cli")
    go(dataset, run, recipe=steady.with_changes(epochs=1))
    assert "training from random weights" in caplog.text
    caplog.clear()
    parts = go(dataset, run, recipe=steady, progress=lambda report: steps.append(report.step))
    assert steps[0] == 3
    assert "resuming after 1 of 2 epochs, step 2, from" in caplog.text
    assert "random" not in caplog.text
    require_same(go(dataset, tmp_path / "whole", recipe=steady), parts)
    fewer = steady.with_changes(epochs=1)
    refused(OutputError, run / "train.json", dataset, run, recipe=fewer)


def test_more_epochs_are_refused_if_they_change_the_schedule(dataset, tmp_path):
    plan, run = TINY.with_changes(epochs=1), tmp_path / "run"
    go(dataset, run, recipe=plan)
    more = plan.with_changes(epochs=2)
    refused(OutputError, run / "train.json", dataset, run, recipe=more)


def test_files_that_no_training_wrote_are_not_replaced(dataset, tmp_path):
    stop_at(dataset, tmp_path / "run", 3)
    for name in ("best.safetensors", "log.csv"):
        for theirs in (tmp_path / f"new {name}" / name, tmp_path / "run" / name):
            theirs.parent.mkdir(exist_ok=True)
            before = theirs.read_bytes() if theirs.exists() else None
            theirs.write_text("mine")
            for overwrite in (False, True):
                refused(OutputError, theirs, dataset, theirs.parent, overwrite=overwrite)
                assert theirs.read_text() == "mine"
            if before is not None:
                OwnedFolder(theirs.parent).write(theirs, before)


def test_rare_classes_and_weights_come_from_the_training_split(dataset, tmp_path):
    labels = np.full(1800, 40, np.uint32)
    labels[:10] = 30  # person: 10 of 1800 points
    labels[10:100] = 10
    for stem, of_scan in zip("012", np.split(labels, 3), strict=True):
        write_labels(dataset / "sequences" / "00" / "labels" / f"{stem}.label", of_scan)
    with calls_of(Training.fit) as fits:
        go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1))
    space = label_space()
    (training,) = [call["self"] for call in fits]
    counts = json.loads((tmp_path / "run" / "class_counts.json").read_text())["points"]
    assert {n: c for n, c in counts.items() if c} == {"person": 10, "car": 90, "road": 1700}
    rare = [name for name in np.array(space.names)[training.batches.samples.rare] if counts[name]]
    assert rare == ["person"]
    expected = class_weights(np.array([counts[n] for n in space.names]), space.scored)
    assert torch.equal(training.learner.loss.weights, expected)


def test_training_starts_from_given_weights(dataset, tmp_path, caplog):
    space, weights = label_space(), tmp_path / "start.safetensors"
    card = WeightsCard({"name": "salsanext", "class_count": 20}, space, SMALL)
    save_weights(weights, TinyNetwork(), card)
    still = TINY.with_changes(epochs=1, learning_rate=1e-30, average=0.0, weight_decay=0.0)
    result = go(dataset, tmp_path / "run", recipe=still, weights=weights, sensor=None)
    before, after = load_file(weights), load_file(result.last)
    torch.testing.assert_close(after["logits.weight"], before["logits.weight"])
    assert not torch.equal(after["norm.running_mean"], before["norm.running_mean"])
    assert read_card(result.last).sensor.view() == SMALL.view()
    labels = {**space.to_dict(), "labels": {**space.to_dict()["labels"], 10: "automobile"}}
    other = replace(card, space=LabelSpace.from_dict(labels, "other"))
    save_weights(weights, TinyNetwork(), other)
    caplog.set_level(NOTICE)
    renewed = go(dataset, tmp_path / "other", recipe=still, weights=weights, sensor=None)
    assert "weights of 19 of 20 classes reused; at random: car" in caplog.messages
    old, new = (load_file(path)["logits.weight"] for path in (weights, renewed.last))
    others = [index for index, name in enumerate(space.names) if name != "car"]
    torch.testing.assert_close(new[others], old[others])
    assert not torch.allclose(new[1], old[1])


def test_labels_are_learnt_in_merged_classes_by_the_splits_of_the_data_set(dataset, tmp_path):
    described = label_space().to_dict() | {"split": {"train": [8], "valid": [0]}}
    (dataset / "labels.yaml").write_text(json.dumps(described))
    once = TINY.with_changes(epochs=1)
    result = go(dataset, tmp_path / "run", recipe=once, space=label_space("coarse"))
    card = read_card(result.best)
    assert card.space.fits(label_space("coarse"))
    assert card.space.splits == {"train": ("08",), "valid": ("00",)}
    assert load_file(result.best)["logits.weight"].shape[0] == 8


def test_lack_of_memory_names_the_step(dataset, tmp_path, monkeypatch):
    class Full(TinyNetwork):
        def trunk(self, image):
            raise torch.OutOfMemoryError

    monkeypatch.setitem(ARCHITECTURES, "salsanext", Full)
    assert "accumulate" in refused(TrainingError, "step 1", dataset, tmp_path / "run").hint


@pytest.mark.parametrize(
    ("spoilt", "saving_s", "taken"),
    [(1, 600, 3), (4, 600, 5), (0, -1.0, 1)],
    ids=["after some steps", "at the end of an epoch", "before a checkpoint"],
)
def test_late_checks_name_the_scans_of_the_step(
    spoilt, saving_s, taken, dataset, tmp_path, monkeypatch
):
    """As on a GPU. Nothing is written after a step that is not finite."""
    steps = []

    def learn(self, images, truth, step, steps_per_epoch):
        steps.append(step)
        return torch.tensor(math.nan if step == spoilt else 1.0)

    monkeypatch.setattr(fit, "CHECK_INTERVALS", {"cpu": 3})
    monkeypatch.setattr(fit, "SAVE_INTERVAL_S", saving_s)
    monkeypatch.setattr(Learner, "step", learn)
    with calls_of(Samples.__getitem__) as draws, pytest.raises(TrainingError) as caught:
        go(dataset, tmp_path / "run", recipe=TINY.with_changes(samples_per_epoch=10))
    drawn = {}
    for call in draws:
        number, place = call["key"][:2]
        drawn[number] = call["self"].scan_at(place)[1].path
    names = f"{drawn[2 * spoilt]}, {drawn[2 * spoilt + 1]}"
    assert caught.value.subject == f"step {spoilt + 1}"
    assert caught.value.problem.endswith(names)
    assert steps == list(range(taken))
    assert not (tmp_path / "run/checkpoint.safetensors").exists()


@pytest.mark.parametrize(
    ("jobs", "device", "cores", "expected"),
    [(None, "cpu", 16, 0), (None, "meta", 16, 8), (None, "meta", 6, 6), (1, "meta", 16, 0)],
)
def test_processes_that_prepare_samples(
    jobs, device, cores, expected, dataset, tmp_path, monkeypatch
):
    """The GPU is one without memory, so the training ends before its first step."""

    @contextmanager
    def group(name):
        yield SINGLE_PROCESS, torch.device(device)

    def end(self, files, validation):
        assert self.workers == expected
        raise Stopped

    stage = sys.modules["salsanext_cli.commands.stages.train"]
    monkeypatch.setattr(stage, "cores", lambda: cores)
    monkeypatch.setattr(stage, "process_group", group)
    new_training = sys.modules["salsanext_cli.commands.stages.new_training"]
    monkeypatch.setattr(new_training, "class_counts", lambda *_: SimpleNamespace(warnings=[]))
    monkeypatch.setattr(Setup, "training", end)
    with pytest.raises(Stopped):
        go(dataset, tmp_path / "run", jobs=jobs)


def test_a_failure_before_the_first_step_leaves_an_earlier_training(dataset, tmp_path):
    first = go(dataset, tmp_path / "run", recipe=TINY.with_changes(epochs=1))
    (dataset / "sequences/00/labels/1.label").unlink()
    with pytest.raises(LabelError):
        go(dataset, tmp_path / "run", overwrite=True)
    assert first.best.exists()
    assert (tmp_path / "run/checkpoint.safetensors").exists()


@pytest.mark.parametrize(
    ("sequence", "stems", "count", "label", "error", "subject"),
    [
        ("00", "1", None, 0, LabelError, "sequences/00/labels/1.label"),
        ("08", "1", 9, 40, LabelError, "sequences/08/labels/1.label"),
        ("00", "012", 600, 0, TrainingError, "sequences/00/labels"),
        # Of the two, only the first is scored, and only the second is labelled.
        ("08", "0", 600, 0, TrainingError, "sequences/08/labels"),
    ],
)
def test_labels_that_cannot_be_trained_on_stop_it_before_the_first_step(
    sequence, stems, count, label, error, subject, dataset, tmp_path
):
    for stem in stems:
        path = dataset / "sequences" / sequence / "labels" / f"{stem}.label"
        if count is None:
            path.unlink()
        else:
            write_labels(path, np.full(count, label, np.uint32))
    one = TINY.with_changes(validation_scans=1)
    refused(error, dataset / subject, dataset, tmp_path / "run", recipe=one)


def test_a_data_set_without_validation_scans_is_refused(dataset, tmp_path):
    (dataset / "sequences" / "08").rename(dataset / "sequences" / "99")
    refused(NoInputError, dataset, dataset, tmp_path / "run")
