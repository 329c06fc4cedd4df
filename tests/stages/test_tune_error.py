# SPDX-License-Identifier: MIT
"""Stage `tune error`, and the probabilities that `predict` and `uncertainty` write with it."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from world import World

from salsanext_cli import label_space, project, read_labels, read_scan, write_labels
from salsanext_cli.errors import (
    NOTICE,
    LabelError,
    OutputError,
    TrainingError,
    UsageError,
    WeightsError,
)
from salsanext_cli.measures.expected_accuracy import expected_accuracy
from salsanext_cli.network.card import AccuracyLine, read_card
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.results.paths import ERROR, find_scans
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.stages.evaluate import evaluate
from salsanext_cli.stages.models import describe_weights
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune import tune
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.training.tuning import error
from salsanext_cli.uncertainty.error_features import FEATURES
from salsanext_cli.uncertainty.method import UncertaintyMethod

ALL = ScanSelection()
EVERY = ScanSelection(sequences=("00", "08"))


@pytest.fixture
def in_few_steps(monkeypatch) -> None:
    """Fit an error model that is good for nothing, and take it for a good one."""
    monkeypatch.setattr(error, "MIN_STEPS", 1)
    monkeypatch.setattr(error, "gains", lambda model: True)


@pytest.fixture
def far_is_wrong(world: World, tmp_path) -> World:
    """Label all scans as the network does, but for points beyond their median range."""
    predict_scans(world.data, tmp_path / "own", settings=world.network)
    for path in sorted(world.data.rglob("*.bin")):
        sequence = path.parent.parent.name
        own = tmp_path / "own/sequences" / sequence / "predictions" / f"{path.stem}.label"
        labels = read_labels(own).copy()
        ranges = np.linalg.norm(np.fromfile(path, "f4").reshape(-1, 4)[:, :3], axis=1)
        far = ranges > np.median(ranges)
        labels[far] = np.where(labels[far] == 10, 40, 10)
        write_labels(path.parent.parent / "labels" / f"{path.stem}.label", labels)
    return world


@pytest.mark.usefixtures("in_few_steps")
def test_labels_of_several_classes_are_left_out_and_said(world: World, target) -> None:
    space = label_space()
    own, shares = replace(space, alternatives={10: (1, 4)}), []
    (world.data / "labels.yaml").write_text(json.dumps(own.to_dict()))
    for file in find_scans(world.data):
        image = project(read_scan(file.path), world.network.load().sensor)
        seen = image.pixel_of_point >= 0
        raw = read_labels(file.label_path)
        shares.append((raw[seen] == 10).sum() / (space.to_train(raw[seen]) > 0).sum())
    tuned = tune("error", world.data, target, settings=world.network, selection=EVERY)
    assert tuned["several"] == pytest.approx(np.mean(shares), abs=1e-3)
    assert 0 < tuned["several"] < 1
    again = tune(
        "error", world.data, target, settings=world.network, selection=EVERY, overwrite=True
    )
    assert again == tuned


def test_what_is_wrong_is_found_in_scans_left_out(far_is_wrong: World, target, tmp_path) -> None:
    world = far_is_wrong
    tuned = tune("error", world.data, target, settings=world.network, selection=EVERY)
    assert (tuned["scans"], tuned["sequences"], tuned["folds"]) == (3, ["00", "08"], 2)
    assert tuned["error"]["auroc"] > 0.97 > tuned["confidence"]["auroc"]
    assert tuned["error"]["aurc"] < tuned["confidence"]["aurc"]
    stored = read_card(target).error
    assert stored is not None
    assert stored.features == FEATURES
    about_the_run = {"stage", "changed", "skipped"}
    assert tuned["changed"]
    assert stored.scores == {key: tuned[key] for key in tuned.keys() - about_the_run}
    assert describe_weights(target).to_dict()["error"] == stored.scores
    network = replace(world.network, weights=target)
    predict_scans(world.data, world.out, settings=network, extras=(ERROR,))
    error = np.load(world.result(ERROR))
    path = world.scan()
    ranges = np.linalg.norm(np.fromfile(path, "f4").reshape(-1, 4)[:, :3], axis=1)
    known = ~np.isnan(error)
    assert ((error >= 0) & (error <= 1))[known].all()
    far = (ranges > np.median(ranges))[known]
    assert error[known][far].mean() > 0.8 > 0.2 > error[known][~far].mean()
    few = tmp_path / "few"
    rejected = predict_scans(world.data, few, settings=network, reject=0.5).rejected_points
    above = [np.load(path) > 0.5 for path in world.out.rglob("error/*.npy")]
    assert rejected == sum(each.sum() for each in above)
    labels = read_labels(world.result("predictions"))
    kept = read_labels(few / "sequences/08/predictions/000000.label")
    np.testing.assert_array_equal(kept, np.where(error > 0.5, 0, labels))
    with pytest.raises(OutputError, match=r"reject was 0\.5 and is 0\.4"):
        predict_scans(world.data, few, settings=network, reject=0.4)
    assert ResultFolder(few).provenance(ALL)["reject"] == 0.5
    # What was rejected is missed, but says nothing of how good the error is.
    space, scans = label_space(), find_scans(world.data)
    judged, whole = (
        evaluate(scans, out, space).uncertainty.kinds["error"].scores for out in (few, world.out)
    )
    scored = [space.scored[space.to_train(read_labels(scan.label_path))] for scan in scans]
    errors = [np.load(world.result(ERROR, scan.sequence, scan.stem)) for scan in scans]
    lost = sum((each[known] > 0.5).sum() for each, known in zip(errors, scored, strict=True))
    assert judged.points == whole.points - lost < whole.points
    assert judged.wrong < whole.wrong - 0.5 * lost
    results = ResultFolder(few).read(scans[0], truth_in=(space, space))
    np.testing.assert_array_equal(np.isnan(results.wrong(space)), ~scored[0] | (errors[0] > 0.5))
    scans = find_scans(world.data)
    found = evaluate(scans, world.out, label_space()).uncertainty.kinds["error"]
    assert found.ece < 0.1
    # Errors go with the labels that they are of.
    some = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(world.data, world.out, settings=network, method=some)
    np.testing.assert_array_equal(np.load(world.result(ERROR)), error)
    # Passes of dropout change the labels, not the model.
    other = tmp_path / "uncertain"
    uncertainty(world.data, other, settings=network, method=some)
    assert {p.name for p in (other / "sequences/08/uncertainty").iterdir()} >= {"error", "entropy"}
    # Other labels take the place of these: their errors are not known.
    predict_scans(world.data, other, settings=network, options=RunOptions(overwrite=True))
    assert (other / "sequences/08/uncertainty/entropy/000000.npy").exists()
    assert not list(other.rglob("error/*.npy"))
    uncertainty(world.data, other, settings=network, method=some)
    assert not list(other.rglob("error/*.npy"))


def test_weights_without_it_are_refused(world: World, target, tmp_path) -> None:
    with pytest.raises(WeightsError, match=r"no probability of errors .* `salsanext tune error"):
        predict_scans(world.data, world.out, settings=world.network, extras=(ERROR,))
    assert not world.out.exists()
    uncertainty(
        world.data,
        world.out,
        settings=world.network,
        method=UncertaintyMethod(samples=2, aleatoric="none"),
    )
    assert not world.result(ERROR).exists()


@pytest.mark.usefixtures("in_few_steps")
def test_other_features_and_merged_classes_are_refused(far_is_wrong: World, target) -> None:
    world = far_is_wrong
    tune("error", world.data, target, settings=world.network, selection=EVERY)
    network = replace(world.network, weights=target)
    coarse = replace(network, classes=label_space("coarse"))
    with pytest.raises(UsageError, match=r"--classes: .*labels before merging"):
        predict_scans(world.data, world.out, settings=coarse, extras=(ERROR,))
    card = read_card(target)
    assert card.error is not None
    names = ("something else", *FEATURES[1:])
    save_with_card(target, target, replace(card, error=replace(card.error, features=names)))
    with pytest.raises(WeightsError, match="errors by other features"):
        predict_scans(world.data, world.out, settings=network, extras=(ERROR,))


@pytest.mark.usefixtures("in_few_steps")
def test_another_temperature_leaves_the_errors_as_they_are(
    far_is_wrong: World, target, tmp_path
) -> None:
    world = far_is_wrong
    tune("error", world.data, target, settings=world.network, selection=EVERY)
    card, line = read_card(target), AccuracyLine(1.2, -0.3, 0.05)
    save_with_card(target, target, replace(card, accuracy=line))
    tempered = target.with_name("tempered.safetensors")
    runs = [replace(world.network, weights=weights) for weights in (target, tempered)]
    tuned = tune("temperature", world.data, tempered, settings=runs[0], selection=EVERY)
    assert tuned["changed"]
    assert read_card(tempered).temperature == tuned["after"]["temperature"] != 1
    errors, expected = [], []
    for number, network in enumerate(runs):
        out = tmp_path / str(number)
        summary = predict_scans(world.data, out, settings=network, extras=(ERROR,)).summary
        assert summary is not None
        # Without warnings, since flatter probabilities are of low confidence.
        expected.append(expected_accuracy(summary.accuracy, summary.confidences, {}).accuracy)
        errors.append([np.load(path) for path in sorted(out.rglob("error/*.npy"))])
    for before, after in zip(*errors, strict=True):
        np.testing.assert_allclose(after, before, atol=2e-3)
    # The labels are the same, so as many are right.
    assert expected[1] == pytest.approx(expected[0], abs=0.01)
    # A further fit starts from the model at its temperature.
    again = target.with_name("again.safetensors")
    tune("error", world.data, again, settings=runs[1], selection=EVERY)
    model = read_card(again).error
    assert model is not None
    assert model.temperature == 1


def test_a_fit_that_is_no_better_leaves_the_weights_as_they_are(
    far_is_wrong: World, target, caplog, monkeypatch
) -> None:
    world = far_is_wrong
    caplog.set_level(NOTICE)
    tune("error", world.data, target, settings=world.network, selection=EVERY)
    network, again = replace(world.network, weights=target), target.with_name("again.safetensors")
    # One step makes a good model worse.
    monkeypatch.setattr(error, "MIN_STEPS", 1)
    monkeypatch.setattr(error, "EPOCHS", 1)
    monkeypatch.setattr(error, "LEARNING_RATE", 1.0)
    tuned = tune("error", world.data, again, settings=network, selection=EVERY)
    assert not tuned["changed"]
    assert tuned["existing"]["aurc"] < tuned["error"]["aurc"]
    assert again.read_bytes() == target.read_bytes()
    assert "the error model is unchanged" in caplog.text
    # Without a model, and no better than the confidence, there is none.
    tuned = tune(
        "error", world.data, again, settings=world.network, selection=EVERY, overwrite=True
    )
    assert (tuned["changed"], tuned["existing"], read_card(again).error) == (False, None, None)


@pytest.mark.usefixtures("in_few_steps")
def test_what_is_said_of_an_error_model_goes_with_it(far_is_wrong: World, target) -> None:
    world = far_is_wrong
    tune("error", world.data, target, settings=world.network, selection=EVERY)
    card = read_card(target)
    assert card.error is not None
    # Older files hold it in their description.
    scores = {key: value for key, value in card.error.scores.items() if key != "fitted_to"}
    sentence = "Trained on nothing. The error is fitted to simulated scans only. Not for use."
    older = replace(card, error=replace(card.error, scores=scores), description=sentence)
    save_with_card(target, target, older)
    described = describe_weights(target)
    assert described.card.description == "Trained on nothing. Not for use."
    assert described.card.error.scores["fitted_to"] == "simulated scans only"
    network, again = replace(world.network, weights=target), target.with_name("again.safetensors")
    tune("error", world.data, again, settings=network, selection=EVERY)
    described = describe_weights(again)
    assert described.card.error.scores["fitted_to"].startswith(
        "3 scans of 00, 08, from one fitted to sim"
    )
    assert (
        read_card(again).changed("Pruned.").description
        == "Trained on nothing. Not for use. Pruned."
    )


def test_labels_that_teach_nothing(world: World, target, tmp_path) -> None:
    own = tmp_path / "own"
    predict_scans(world.data, own, settings=world.network)
    for sequence in ("00", "08"):
        labels = world.data / "sequences" / sequence / "labels"
        shutil.copytree(own / "sequences" / sequence / "predictions", labels, dirs_exist_ok=True)
    with pytest.raises(TrainingError, match=r"no label of \d+ points is wrong"):
        tune("error", world.data, target, settings=world.network, selection=EVERY)
    for path in (world.data / "sequences").rglob("*.label"):
        write_labels(path, np.zeros(1500, np.uint32))
    with pytest.raises(LabelError, match="no point is of a class that counts"):
        tune("error", world.data, target, settings=world.network, selection=EVERY)
    assert not target.exists()


@pytest.mark.usefixtures("in_few_steps")
def test_a_single_scan_is_not_cross_validated(far_is_wrong: World, target, caplog) -> None:
    world = far_is_wrong
    selection = ScanSelection(split="valid", limit=1)
    tuned = tune("error", world.data, target, settings=world.network, selection=selection)
    assert (tuned["folds"], tuned["error"], tuned["confidence"]) == (0, None, None)
    assert "1 scan: not cross-validated" in caplog.messages
    assert read_card(target).error is not None
    # One scan does not show that another model would be better.
    network, again = replace(world.network, weights=target), target.with_name("again.safetensors")
    for part in ("error", "temperature"):
        tune(part, world.data, again, settings=network, selection=selection, overwrite=True)
        assert read_card(again).error is not None
