# SPDX-License-Identifier: MIT
"""Stage `tune error`, and the probabilities that `predict` and `uncertainty` write with it."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scans import refused, write_weights
from shallow_network import shallow  # noqa: F401
from world import World

from salsanext_cli import label_space, project, read_labels, read_scan, write_labels
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import (
    LabelError,
    OutputError,
    TrainingError,
    UsageError,
    WeightsError,
)
from salsanext_cli.core.measures.expected_accuracy import expected_accuracy
from salsanext_cli.core.network.card import AccuracyLine
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.training.tuning import error_training

ALL = ScanSelection()
SPACE = label_space()


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return shallow weights that are confident, with labels of several classes."""
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors", seed=9)


@pytest.fixture
def world(world: World) -> World:
    """Return the world with the sensor of its scans: nothing here depends on a fit."""
    return world.unfitted()


def label_far_points_wrongly(world: World) -> World:
    """Label all scans as the network does, except points beyond their median range."""
    truth = world.out.with_name("truth")
    predict_scans(world.data, truth, settings=world.network)
    for file in find_scans(world.data):
        path = output_path(truth, file.sequence, "predictions", file.stem)
        labels, far = read_labels(path).copy(), is_far(file.path)
        labels[far] = np.where(labels[far] == 10, 40, 10)
        write_labels(file.label_path, labels)
    return world


@pytest.fixture
def far_is_wrong(world: World) -> World:
    return label_far_points_wrongly(world)


def is_far(scan: Path) -> np.ndarray:
    ranges = np.linalg.norm(read_scan(scan).points, axis=1)
    return ranges > np.median(ranges)


@pytest.mark.usefixtures("in_few_steps")
def test_labels_of_several_classes_are_skipped_and_counted(world: World, target) -> None:
    space = label_space()
    described, shares = replace(space, alternatives={10: (1, 4)}), []
    (world.data / "labels.yaml").write_text(json.dumps(described.to_dict()))
    for file in find_scans(world.data):
        image = project(read_scan(file.path), world.network.load().sensor)
        seen = image.pixel_of_point >= 0
        raw = read_labels(file.label_path)
        shares.append((raw[seen] == 10).sum() / (space.to_train(raw[seen]) > 0).sum())
    tuned = world.tune("error", target)
    assert tuned["several"] == pytest.approx(np.mean(shares), abs=1e-3)
    assert 0 < tuned["several"] < 1
    again = world.tune("error", target, overwrite=True)
    assert again == tuned


@dataclass(frozen=True, kw_only=True)
class FittedRuns:
    """Weights with an error model, a run that writes the errors, and one that rejects by them."""

    world: World
    """Its output folder has the errors of all labels."""
    target: Path
    tuned: dict[str, Any]
    """Report of `tune error`."""
    rejecting: Path
    """Output folder of the run that rejects labels above an error of 0.5."""
    rejected_points: int

    @property
    def network(self) -> NetworkSettings:
        return replace(self.world.network, weights=self.target)

    @property
    def scans(self) -> list[ScanFile]:
        return find_scans(self.world.data)

    def errors(self) -> list[np.ndarray]:
        """Return the errors (N,) of each scan."""
        return [np.load(self.world.result(ERROR, scan.sequence, scan.stem)) for scan in self.scans]

    def scored(self) -> list[np.ndarray]:
        """Return which points of each scan have a scored class."""
        return [SPACE.scored[SPACE.to_train(read_labels(scan.label_path))] for scan in self.scans]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> FittedRuns:
    folder = tmp_path_factory.mktemp("error")
    world = label_far_points_wrongly(World.made(folder, weights).unfitted())
    target, rejecting = folder / "tuned.safetensors", folder / "rejecting"
    tuned = world.tune("error", target)
    network = replace(world.network, weights=target)
    predict_scans(world.data, world.out, settings=network, extras=(ERROR,))
    outcome = predict_scans(world.data, rejecting, settings=network, reject=0.5)
    return FittedRuns(
        world=world,
        target=target,
        tuned=tuned,
        rejecting=rejecting,
        rejected_points=outcome.rejected_points,
    )


FEW_PASSES = UncertaintyMethod(samples=2, aleatoric="none")


def test_the_report_has_the_scores_on_held_out_scans(runs):
    tuned = runs.tuned
    assert (tuned["scans"], tuned["sequences"], tuned["folds"]) == (3, ["00", "08"], 2)
    assert tuned["error"]["auroc"] > 0.97 > tuned["confidence"]["auroc"]
    assert tuned["error"]["aurc"] < tuned["confidence"]["aurc"]
    assert tuned["changed"]


def test_the_card_has_the_model_and_its_scores(runs):
    stored, tuned = read_card(runs.target).error, runs.tuned
    assert stored.features == FEATURES
    about_the_run = {"stage", "changed", "skipped", "weights"}
    assert stored.scores == {key: tuned[key] for key in tuned.keys() - about_the_run}
    assert describe_weights(runs.target).to_dict()["error"] == stored.scores


def test_errors_are_probabilities_and_high_where_labels_are_wrong(runs):
    error = np.load(runs.world.result(ERROR))
    known = ~np.isnan(error)
    assert ((error >= 0) & (error <= 1))[known].all()
    far = is_far(runs.world.scan())[known]
    assert error[known][far].mean() > 0.8 > 0.2 > error[known][~far].mean()
    judged = evaluate_scans(runs.scans, runs.world.out, SPACE).uncertainty.kinds["error"]
    assert judged.ece < 0.1


def test_labels_above_an_error_are_rejected(runs):
    assert runs.rejected_points == sum((error > 0.5).sum() for error in runs.errors())
    labels = read_labels(runs.world.result("predictions"))
    accepted = read_labels(runs.rejecting / "sequences/08/predictions/000000.label")
    error = np.load(runs.world.result(ERROR))
    np.testing.assert_array_equal(accepted, np.where(error > 0.5, 0, labels))


def test_a_folder_has_one_limit_of_the_error(runs):
    with refused(OutputError, runs.rejecting / "predict.json"):
        predict_scans(runs.world.data, runs.rejecting, settings=runs.network, reject=0.4)
    assert Provenance(runs.rejecting).recorded_settings(ALL, None)["reject"] == 0.5


def test_rejected_points_do_not_count_in_the_scores_of_the_error(runs):
    """They are misses of the labels."""
    kinds = [
        evaluate_scans(runs.scans, out, SPACE).uncertainty.kinds
        for out in (runs.rejecting, runs.world.out)
    ]
    judged, whole = (of_run["error"] for of_run in kinds)
    pairs = list(zip(runs.errors(), runs.scored(), strict=True))
    lost = sum((error[scored] > 0.5).sum() for error, scored in pairs)
    assert judged.points == whole.points - lost < whole.points
    assert judged.wrong < whole.wrong - 0.5 * lost
    error, scored = pairs[0]
    results = ResultFolder(runs.rejecting).read(runs.scans[0], truth_in=(SPACE, SPACE))
    np.testing.assert_array_equal(np.isnan(results.wrong(SPACE)), ~scored | (error > 0.5))


def test_errors_stay_with_their_labels_when_uncertainty_follows(runs, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(runs.world.out, out)
    before = np.load(runs.world.result(ERROR))
    uncertainty(runs.world.data, out, settings=runs.network, method=FEW_PASSES)
    np.testing.assert_array_equal(np.load(output_path(out, "08", ERROR, "000000")), before)


def test_errors_of_replaced_labels_are_removed(runs, tmp_path):
    """Passes of dropout change the labels, not the model."""
    out, data, network = tmp_path / "uncertain", runs.world.data, runs.network
    uncertainty(data, out, settings=network, method=FEW_PASSES)
    assert {p.name for p in (out / "sequences/08/uncertainty").iterdir()} >= {"error", "entropy"}
    predict_scans(data, out, settings=network, options=RunOptions(overwrite=True))
    assert (out / "sequences/08/uncertainty/entropy/000000.npy").exists()
    assert not list(out.rglob("error/*.npy"))
    uncertainty(data, out, settings=network, method=FEW_PASSES)
    assert not list(out.rglob("error/*.npy"))


def test_weights_without_it_are_refused(world: World) -> None:
    with pytest.raises(WeightsError) as caught:
        predict_scans(world.data, world.out, settings=world.network, extras=(ERROR,))
    assert "`salsanext tune error" in caught.value.hint
    assert not world.out.exists()
    few = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(world.data, world.out, settings=world.network, method=few)
    assert not world.result(ERROR).exists()


@pytest.mark.usefixtures("in_few_steps")
def test_other_features_and_merged_classes_are_refused(far_is_wrong: World, target) -> None:
    world = far_is_wrong
    world.tune("error", target)
    network = replace(world.network, weights=target)
    coarse = replace(network, classes=label_space("coarse"))
    with refused(UsageError, "classes"):
        predict_scans(world.data, world.out, settings=coarse, extras=(ERROR,))
    card = read_card(target)
    names = ("something else", *FEATURES[1:])
    save_with_card(target, target, replace(card, error=replace(card.error, features=names)))
    with pytest.raises(WeightsError):
        predict_scans(world.data, world.out, settings=network, extras=(ERROR,))


@pytest.mark.usefixtures("in_few_steps")
def test_another_temperature_leaves_the_errors_as_they_are(far_is_wrong, target, tmp_path):
    world = far_is_wrong
    world.tune("error", target)
    card, line = read_card(target), AccuracyLine(1.2, -0.3, 0.05)
    save_with_card(target, target, replace(card, accuracy=line))
    tempered = target.with_name("tempered.safetensors")
    runs = [replace(world.network, weights=weights) for weights in (target, tempered)]
    tuned = world.tune("temperature", tempered, settings=runs[0])
    assert tuned["changed"]
    assert read_card(tempered).temperature == tuned["after"]["temperature"] != 1
    errors, expected = [], []
    for number, network in enumerate(runs):
        out = tmp_path / str(number)
        summary = predict_scans(world.data, out, settings=network, extras=(ERROR,)).summary
        # Without warnings, since flatter probabilities are of low confidence.
        expected.append(
            expected_accuracy(summary.accuracy, summary.counts.confidences, {}).accuracy
        )
        errors.append([np.load(path) for path in sorted(out.rglob("error/*.npy"))])
    for before, after in zip(*errors, strict=True):
        np.testing.assert_allclose(after, before, atol=2e-3)
    # The labels are the same, so as many are right.
    assert expected[1] == pytest.approx(expected[0], abs=0.01)
    # A further fit starts from the model at its temperature.
    again = target.with_name("again.safetensors")
    world.tune("error", again, settings=runs[1])
    model = read_card(again).error
    assert model.temperature == 1


@pytest.mark.usefixtures("one_step_fits")
def test_a_fit_that_is_no_better_changes_nothing(runs, tmp_path, caplog, monkeypatch):
    world, again = runs.world, tmp_path / "again.safetensors"
    caplog.set_level(NOTICE)
    # One step of such a length makes any model worse.
    monkeypatch.setattr(error_training, "EPOCHS", 1)
    monkeypatch.setattr(error_training, "LEARNING_RATE", 100.0)
    tuned = world.tune("error", again, settings=runs.network)
    assert not tuned["changed"]
    assert tuned["existing"]["aurc"] < tuned["error"]["aurc"]
    assert again.read_bytes() == runs.target.read_bytes()
    assert "the error model is unchanged" in caplog.text
    # Without a model, and no better than the confidence, there is none.
    tuned = world.tune("error", again, overwrite=True)
    assert (tuned["changed"], tuned["existing"], read_card(again).error) == (False, None, None)


@pytest.mark.usefixtures("in_few_steps")
def test_the_origin_of_an_error_model_is_replaced_with_it(far_is_wrong: World, target) -> None:
    world = far_is_wrong
    world.tune("error", target)
    card = read_card(target)
    # Older files hold it in their description.
    scores = {key: value for key, value in card.error.scores.items() if key != "fitted_to"}
    sentence = "Trained on nothing. The error is fitted to simulated scans only. Not for use."
    older = replace(card, error=replace(card.error, scores=scores), description=sentence)
    save_with_card(target, target, older)
    described = describe_weights(target)
    assert described.card.description == "Trained on nothing. Not for use."
    assert described.card.error.scores["fitted_to"] == "simulated scans only"
    network, again = replace(world.network, weights=target), target.with_name("again.safetensors")
    world.tune("error", again, settings=network)
    described = describe_weights(again)
    origin = "3 scans of 00, 08, from one fitted to sim"
    assert described.card.error.scores["fitted_to"].startswith(origin)


def test_labels_without_anything_to_learn_are_refused(world: World, target, tmp_path) -> None:
    predict_scans(world.data, tmp_path, settings=world.network)
    for sequence in ("00", "08"):
        labels = world.data / "sequences" / sequence / "labels"
        predicted = tmp_path / "sequences" / sequence / "predictions"
        shutil.copytree(predicted, labels, dirs_exist_ok=True)
    with pytest.raises(TrainingError):
        world.tune("error", target)
    for path in (world.data / "sequences").rglob("*.label"):
        write_labels(path, np.zeros(1500, np.uint32))
    with pytest.raises(LabelError):
        world.tune("error", target)
    assert not target.exists()


@pytest.mark.usefixtures("in_few_steps")
def test_a_single_scan_is_not_cross_validated(far_is_wrong: World, target, caplog) -> None:
    world = far_is_wrong
    selection = ScanSelection(split="valid", limit=1)
    tuned = world.tune("error", target, selection=selection)
    assert (tuned["folds"], tuned["error"], tuned["confidence"]) == (0, None, None)
    assert "1 scan: not cross-validated" in caplog.messages
    assert read_card(target).error is not None
    # One scan does not show that another model would be better.
    network, again = replace(world.network, weights=target), target.with_name("again.safetensors")
    for part in ("error", "temperature"):
        world.tune(part, again, settings=network, selection=selection, overwrite=True)
        assert read_card(again).error is not None
