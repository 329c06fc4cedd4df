# SPDX-License-Identifier: MIT
"""Training with the recipe of few scans: cross-validation, and a training on all of them."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from scans import SMALL, refused, write_sequence
from tiny_network import TinyNetwork

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages import training_scenes
from salsanext_cli.commands.stages.import_labels import import_labels
from salsanext_cli.commands.stages.synth import SynthSettings
from salsanext_cli.commands.stages.train import TrainResult, train
from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.network.card import WeightsCard, scan_digest
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.files.json_files import write_json
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import read_weights, save_weights, save_with_card
from salsanext_cli.runs.annotation.label_records import pre_labelled_scans
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training import cross_validated_training
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.recipe import Recipe

FEW = Recipe(
    initial="default",
    folds=2,
    epochs=3,
    batch=2,
    samples_per_epoch=4,
    crop_width=32,
    optimiser="adamw",
    learning_rate=5e-3,
    schedule="decay",
    decay=1.0,
    warm_up=0.0,
    average=0.5,
    sensors="fitted",
)
SHORT = FEW.with_changes(epochs=1, samples_per_epoch=2)
"""For tests that ask what is trained on, not how the number of epochs is chosen."""

pytestmark = pytest.mark.usefixtures("tiny_training")


@pytest.fixture(autouse=True)
def initial(
    tiny_training: None,
    one_step_fits: None,
    take_by_default: Callable[[Path], None],
    tmp_path: Path,
) -> Path:
    """Put a tiny network in the place of the default weights."""
    path = tmp_path / "initial.safetensors"
    card = WeightsCard({"name": "salsanext", "class_count": 20}, label_space(), SMALL)
    torch.manual_seed(1)
    save_weights(path, TinyNetwork(), card)
    take_by_default(path)
    return path


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Three scans of three places that no split names."""
    for name in ("a", "b", "c"):
        write_sequence(tmp_path / "data/sequences" / name, ["0"], count=600)
    return tmp_path / "data"


def write_splits(data: Path, **splits: list[str]) -> None:
    """Write the label space of a data set with some splits."""
    (data / "labels.yaml").write_text(json.dumps(label_space().to_dict() | {"split": splits}))


def go(data: Path, run: Path, recipe: Recipe = FEW, **changes: object) -> TrainResult:
    return train(data, run, recipe=recipe, device="cpu", **changes)  # type: ignore[arg-type]


def test_the_folds_choose_the_epochs_and_all_scans_are_trained_on(data, tmp_path, monkeypatch):
    monkeypatch.setattr(cross_validated_training, "gains", lambda _: True)
    reports: list[StepReport] = []
    pages: list[str] = []
    run = tmp_path / "run"

    def watch(report: StepReport) -> None:
        reports.append(report)
        if report.row:
            pages.append((run / "training.html").read_text("utf-8"))

    result = go(data, run, progress=watch)
    expected = result.expected
    assert expected.folds == 2
    # The page of the run shows each fold, and is complete after the training itself.
    for page, report in zip(pages, [r for r in reports if r.row], strict=True):
        assert (f"fold {report.fold} of 2, epoch {report.epoch} of 3" in page) == (report.fold > 0)
        folder = run / "folds" / str(report.fold) if report.fold else run
        assert f'src="{(folder / "curve.png").relative_to(run).as_posix()}"' in page
        assert (folder / "curve.png").exists()
        is_last = report.fold == 0 and report.epoch == expected.epochs
        assert ('http-equiv="refresh"' in page) != is_last
    assert [r.fold for r in reports if r.row] == [1] * 3 + [2] * 3 + [0] * expected.epochs
    steps = [(r.step, r.steps) for r in reports]
    assert [step for step, _ in steps] == list(range(1, len(steps) + 1))
    assert steps[-1][0] == steps[-1][1] == 12 + 2 * expected.epochs
    of_folds = [[r.row for r in reports if r.row and r.fold == fold] for fold in (1, 2)]
    means = np.mean([[row["miou"] for row in rows] for rows in of_folds], axis=0)
    assert expected.epochs == 1 + means.argmax()
    # Of two folds each is scored after the number of epochs that is best for the other.
    mious = np.array([[row["miou"] for row in rows] for rows in of_folds])
    scored = [mious[0, mious[1].argmax()], mious[1, mious[0].argmax()]]
    assert expected.miou == pytest.approx(np.mean(scored))
    assert result.best_miou is None
    card = read_card(result.best)
    chosen = [rows[expected.epochs - 1] for rows in of_folds]
    logarithms = [math.log(row["temperature"]) for row in chosen]
    assert card.temperature == pytest.approx(math.exp(sum(logarithms) / 2))
    assert card.scores["miou"] == expected.miou
    assert card.recipe == FEW.with_changes(epochs=expected.epochs).to_dict()
    assert result.best.read_bytes() == result.last.read_bytes()
    # The error model is fitted to all scans, each held out once.
    assert card.error.scores["scans"] == 3
    assert card.error.scores["folds"] == 2
    # The row of the training itself has no scores, since no scan is held out.
    assert "miou" not in result.rows[-1]
    # Nothing is left to do.
    again = go(data, run, progress=lambda report: pytest.fail("a step was taken"))
    assert again == result


def test_a_training_without_improvement_warns(data, tmp_path, initial, monkeypatch, caplog):
    class WithoutStatistics(TinyNetwork):
        def __init__(self, class_count=20, dropout=0.2):
            super().__init__(class_count, dropout)
            self.norm = torch.nn.Identity()

    # With steps of no length the scores stay those of before.
    monkeypatch.setitem(ARCHITECTURES, "salsanext", WithoutStatistics)
    save_weights(initial, WithoutStatistics(), read_card(initial))
    done = go(data, tmp_path / "run", SHORT.with_changes(learning_rate=1e-12))
    expected = done.expected
    assert expected.miou == expected.miou_before > 0
    assert expected.accuracy == expected.accuracy_before > 0
    assert "did not improve the weights" in caplog.text


def test_the_card_names_the_initial_weights(data, tmp_path, initial, monkeypatch, caplog):
    monkeypatch.setattr(cross_validated_training, "gains", lambda _: False)
    card = read_card(go(data, tmp_path / "default", SHORT).best)
    assert card.recipe == SHORT.to_dict()
    assert card.error is None
    assert "no error model: it would be no better than the confidence" in caplog.messages
    other = initial.rename(tmp_path / "other.safetensors")
    # An error model that is better than a new one stays.
    monkeypatch.setattr(cross_validated_training, "is_better", lambda *_: True)
    layers = [(np.ones((len(FEATURES), 1), "f4"), np.zeros(1, "f4"))]
    start = ErrorModel(features=FEATURES, layers=layers, temperature=2.0)
    save_with_card(other, other, replace(read_card(other), error=start))
    result = go(data, tmp_path / "run", SHORT, weights=other)
    model = read_card(result.best).error
    assert model.to_dict() == replace(start, temperature=None).to_dict()
    origin = f"other.safetensors (SHA-256 {fingerprint(other)[:16]})"
    for path in (result.best, result.last, tmp_path / "run/folds/1/last.safetensors"):
        assert read_card(path).recipe == SHORT.to_dict() | {"initial": origin}


class Stopped(BaseException):
    """Ctrl-C at a chosen step."""


@pytest.mark.parametrize(
    "step", [6, *(pytest.param(step, marks=pytest.mark.slow) for step in (1, 9))]
)
def test_a_stopped_training_ends_with_the_same_weights(data, tmp_path, step):
    """In the second of two folds of four steps each, in the first, and in the training on all."""
    recipe, run = FEW.with_changes(epochs=2), tmp_path / "stopped"
    whole = go(data, tmp_path / "whole", recipe)

    def stop(report: StepReport) -> None:
        if report.step == step:
            raise Stopped

    with pytest.raises(Stopped):
        go(data, run, recipe, progress=stop)
    result = go(data, run, recipe)
    assert result.expected == whole.expected
    assert result.best.read_bytes() == whole.best.read_bytes()


def test_scans_without_labels_are_skipped_and_counted(data, tmp_path, caplog):
    caplog.set_level(NOTICE)
    (data / "sequences/c/labels/0.label").unlink()
    result = go(data, tmp_path / "run", SHORT)
    assert "skipped without labels: 1 scan" in caplog.messages
    assert result.expected is not None
    shutil.rmtree(data / "sequences/a/labels")
    shutil.rmtree(data / "sequences/b/labels")
    with pytest.raises(NoInputError):
        go(data, tmp_path / "none")


def test_pre_labels_are_not_trained_on(data, tmp_path, caplog):
    caplog.set_level(NOTICE)
    files = find_scans(data)
    # The record of `pick`; then one pre-label is confirmed and one corrected.
    digests = {f"{file.sequence}/{file.stem}": fingerprint(file.label_path) for file in files}
    (data / "pick.json").write_text(json.dumps({"guesses": digests}))
    import_labels(files[0].label_path, data / "sequences/a")
    write_labels(files[1].label_path, np.roll(read_labels(files[1].label_path), 1))
    assert pre_labelled_scans(files) == files[2:]
    go(data, tmp_path / "run", SHORT)
    assert "skipped without labels: 1 scan, 1 with pre-labels only" in caplog.messages
    write_splits(data, train=["a", "b"], valid=["c"])
    with refused(LabelError, files[2].label_path):
        go(data, tmp_path / "split", SHORT.with_changes(folds=0))


def test_a_single_scan_is_trained_on_with_a_warning(data, tmp_path, caplog):
    for name in ("b", "c"):
        shutil.rmtree(data / "sequences" / name)
    result = go(data, tmp_path / "run", SHORT)
    assert "a single labelled scan gives no estimate for other scans" in caplog.messages
    assert (result.expected, result.best_miou) == (None, None)
    assert result.best.read_bytes() == result.last.read_bytes()


def test_a_validation_split_that_names_every_scan_is_used(data, tmp_path):
    write_splits(data, train=["a", "b"], valid=["c"])
    result = go(data, tmp_path / "run", SHORT)
    assert result.expected is None
    assert result.best_miou == max(row["miou"] for row in result.rows)
    assert not (tmp_path / "run/folds").exists()


def test_without_named_splits_all_labelled_scans_are_trained_on(data, tmp_path, initial, caplog):
    # SemanticKITTI trains on 00 and validates 08.
    for seed, (name, usual) in enumerate((("a", "00"), ("b", "08"), ("c", "c"))):
        (data / "sequences" / name).rename(data / "sequences" / usual)
        write_sequence(data / "sequences" / usual, ["0"], count=600, seed=seed)
    card, (module, _) = read_card(initial), read_weights(initial)
    save_weights(initial, module, replace(card, trained_on=frozenset({"0" * 24})))
    every = [scan_digest(read_scan(file.path)) for file in find_scans(data)]
    caplog.set_level(NOTICE)
    result = go(data, tmp_path / "run", SHORT)
    assert "no splits are named: training on 3 labelled scans of 3 sequences" in caplog.messages
    assert result.best_miou is None
    counts = json.loads((tmp_path / "run/class_counts.json").read_text())["points"]
    assert sum(counts.values()) == 3 * 600
    # Weights record their scans, and those of the initial weights.
    assert read_card(result.best).trained_on == {"0" * 24, *every}
    folds = [read_card(path).trained_on for path in (tmp_path / "run/folds").glob("*/last.*")]
    assert {*map(len, folds)} == {2, 3}
    # Without folds the splits are SemanticKITTI's, and unused scans are named.
    split = go(data, tmp_path / "split", SHORT.with_changes(folds=0))
    assert read_card(split.best).trained_on == {"0" * 24, every[0]}
    assert "2 of 3 scans used; not used: c (no split)" in caplog.text
    shutil.rmtree(data / "sequences/08")
    with pytest.raises(NoInputError) as caught:
        go(data, tmp_path / "none", FEW.with_changes(folds=0))
    assert caught.value.hint.endswith(": folds=3")


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Write tiny scans instead of simulated scenes, too few points for the checks; list them."""
    made: list[Path] = []

    def write(out, *, train, scans, seed, spacing, sensor, **_):
        made.append(out)
        shutil.rmtree(out, ignore_errors=True)
        counts = {"train": train, "valid": 0, "test": 0}
        record = SynthSettings.from_counts(counts, scans, seed, spacing, sensor).record
        write_json(out / "synth.json", record)
        names = [f"{number:02d}" for number in range(train)]
        for name in names:
            stems = [f"{index:06d}" for index in range(scans)]
            write_sequence(out / "sequences" / name, stems, count=90)
        space = replace(label_space(), splits={"train": tuple(names)})
        (out / "labels.yaml").write_text(json.dumps(space.to_dict()))

    monkeypatch.setattr(training_scenes, "synthesise", write)
    return made


def test_simulated_scenes_are_further_data_sets(data, tmp_path, simulated):
    run, recipe = tmp_path / "run", SHORT.with_changes(streets=1, also=0.5)
    with_streets = go(data, run, recipe)
    streets = run / "streets"
    both = [streets / "hdl64", streets / "random"]
    assert simulated == both
    assert "simulated scenes" in read_card(with_streets.best).description
    # The user cannot correct them.
    assert not with_streets.warnings
    digests = {scan_digest(read_scan(file.path)) for file in find_scans(data)}
    assert read_card(with_streets.best).trained_on == digests
    alone = SHORT.with_changes(also=0.5)
    given = go(data, tmp_path / "given", alone, also=both)
    assert {warning.code for warning in given.warnings} == {"few-points"}
    assert read_card(given.best).trained_on > digests
    without = go(data, tmp_path / "without", alone)
    tensors = [load_file(result.best) for result in (with_streets, given, without)]
    for name, tensor in tensors[0].items():
        assert torch.equal(tensor, tensors[1][name])
    assert not all(torch.equal(tensor, tensors[2][name]) for name, tensor in tensors[0].items())


@pytest.mark.slow
def test_scenes_of_another_version_or_settings_are_made_again(data, tmp_path, simulated, caplog):
    caplog.set_level(NOTICE)
    run, recipe = tmp_path / "run", SHORT.with_changes(streets=1)
    go(data, run, recipe)
    streets = run / "streets/random"
    assert f"simulating 1 scene in {streets}" in caplog.messages
    record = json.loads((streets / "synth.json").read_text())
    denser = record | {"settings": record["settings"] | {"spacing": 3.0}}
    for other in (record | {"version": "0.0.1"}, denser):
        caplog.clear()
        write_json(streets / "synth.json", other)
        go(data, run, recipe)
        (message,) = [text for text in caplog.messages if "simulating" in text]
        assert message.startswith(f"simulating 1 scene in {streets}: ")
    caplog.clear()
    go(data, run, recipe)
    assert "simulating" not in caplog.text


def test_scenes_of_other_classes_are_not_simulated(data, tmp_path, simulated, caplog):
    space = label_space().to_dict()
    space["labels"] = {raw: f"our {name}" for raw, name in space["labels"].items()}
    (data / "labels.yaml").write_text(json.dumps(space))
    with caplog.at_level(NOTICE):
        go(data, tmp_path / "run", SHORT.with_changes(streets=1))
    assert any(message.startswith("no simulated scenes: ") for message in caplog.messages)
    assert not simulated


def test_scans_of_other_splits_are_not_trained_on(data, tmp_path, caplog):
    write_splits(data, train=[], valid=["b"], test=["c"])
    go(data, tmp_path / "run", SHORT)
    assert "1 of 3 scans used; not used: b (split valid), c (split test)" in caplog.text
    write_splits(data, train=[], valid=["b"], test=["a", "c"])
    with pytest.raises(NoInputError):
        go(data, tmp_path / "none")
