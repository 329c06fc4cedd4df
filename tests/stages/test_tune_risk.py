# SPDX-License-Identifier: MIT
"""Stage `tune risk`, and what `predict --reject risk` and `eval` make of its threshold."""

import shutil
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from world import World

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.errors import OutputError, TrainingError, UsageError, WeightsError
from salsanext_cli.files.json_files import plain
from salsanext_cli.measures.risk_control import RISK_BOUND_EXCEEDED
from salsanext_cli.network.card import AccuracyLine, read_card, scan_digest
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.option_fields import KnnParameters, ScanSelection
from salsanext_cli.report.page.run_results import expected_of_run
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.paths import LEAST_CONFIDENCE, find_scans, output_path
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.stages.evaluate import evaluate
from salsanext_cli.stages.models import describe_weights
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.report import read_run, report
from salsanext_cli.stages.tune import tune
from salsanext_cli.training.tuning import error
from salsanext_cli.training.tuning.risk import RiskLevel, _left_out

ALL = ScanSelection()
EVERY = ScanSelection(sequences=("00", "08"))


@pytest.fixture
def unsure_is_wrong(world: World) -> World:
    """Label all scans as the network does, but for the half it is least sure of."""
    own = world.out.with_name("own")
    predict_scans(world.data, own, settings=world.network)
    for path in own.rglob("predictions/*.label"):
        labels = read_labels(path).copy()
        doubt = np.load(path.parent.parent / LEAST_CONFIDENCE / f"{path.stem}.npy")
        wrong = doubt > np.nanmedian(doubt)
        labels[wrong] = np.where(labels[wrong] == 10, 40, 10)
        sequence = path.parent.parent.name
        write_labels(world.data / "sequences" / sequence / "labels" / path.name, labels)
    return world


def test_the_threshold_rejects_what_was_promised(unsure_is_wrong: World, target, caplog) -> None:
    world = unsure_is_wrong
    tuned = tune("risk", world.data, target, settings=world.network, selection=EVERY, at_most=0.3)
    risk = read_card(target).risk
    recorded = {name: value for name, value in plain(risk).items() if name != "classes"}
    assert recorded == {key: tuned[key] for key in recorded}
    assert describe_weights(target).card.risk == risk
    expected = {"kind": "least_confidence", "at_most": 0.3, "confidence": None, "scans": 3}
    assert recorded.items() >= {**expected, "sequences": ["00", "08"]}.items()
    assert [each["sequence"] for each in tuned["left_out"]] == ["00", "08"]
    kept, wrong = np.array(tuned["risk_coverage"])
    shares = np.array(tuned["of_scans"])
    assert np.interp(shares[:, 0].mean(), kept, wrong) == pytest.approx(
        shares[:, 1].mean(), abs=0.01
    )
    assert (np.diff(kept) > 0).all()
    assert (np.diff(wrong) >= 0).all()
    assert target.with_name(f"{target.stem}_risk.png").read_bytes().startswith(b"\x89PNG")
    network = replace(world.network, weights=target)
    caplog.set_level("INFO")
    outcome = predict_scans(world.data, world.out, settings=network, reject="risk")
    doubts, losses, space = [], [], label_space()
    for file in find_scans(world.data):
        doubt = np.load(world.result(LEAST_CONFIDENCE, file.sequence, file.stem))
        above = doubt > risk.threshold
        assert not world.labels(file.sequence, file.stem)[above].any()
        doubts.append(above.sum())
        truth = space.to_train(read_labels(file.label_path))
        kept = space.to_train(world.labels(file.sequence, file.stem)) > 0
        own = read_labels(file.label_path) != world.labels(file.sequence, file.stem)
        losses.append((own & kept & (truth > 0)).sum() / (truth > 0).sum())
    assert outcome.rejected_points == sum(doubts) > 0
    assert tuned["promise"] in "".join(caplog.messages)
    # What was reported of the threshold is what `eval` finds of the run.
    found = evaluate(find_scans(world.data), world.out, space)
    numbers = {"units": 3, "above": sum(loss > 0.3 for loss in losses), "at_most": 0.3}
    numbers |= {"mean": pytest.approx(np.mean(losses)), "worst": pytest.approx(max(losses))}
    numbers |= {"confidence": None, "unit": "scan"}
    assert found.to_dict()["rejection"]["promise"] == numbers
    page = report(world.out).page.read_text("utf-8")
    assert f"<dd>{tuned['promise']}</dd>" in page
    assert all(
        sentence[1:] in page for sentence in (found.guarantee.sentence, *found.accepted.sentences)
    )
    kept = found.accepted
    assert kept is not None
    assert plain(kept) == tuned["kept"]
    # (3 R + 1) / 4 ≤ 0.3, with no finer step than a bin
    assert 0 < kept.wrong / kept.points <= (4 * 0.3 - 1) / 3
    assert "the threshold was chosen on 3 of 3 scans" in caplog.text
    # Nothing was promised of merged classes.
    scans, coarse = ResultFolder(world.out).predicted(ALL, classes=label_space("coarse"))
    assert evaluate(scans, world.out, coarse).guarantee is None
    # What is kept needs no uncertainty.
    world.result(LEAST_CONFIDENCE, file.sequence, file.stem).unlink()
    assert evaluate(find_scans(world.data), world.out, space).guarantee == found.guarantee
    results = ResultFolder(world.out).read(find_scans(world.data)[0], truth_in=(space, space))
    assert results.rejected.sum() == doubts[0]


def test_each_class_has_a_threshold_that_holds_of_its_own_points(
    unsure_is_wrong: World, target, caplog
) -> None:
    world = unsure_is_wrong
    numbers = {"at_most": 0.4, "per_class": True}
    tuned = tune("risk", world.data, target, settings=world.network, selection=EVERY, **numbers)
    risk, space = read_card(target).risk, label_space()
    assert risk.classes == tuned["classes"]
    assert max(risk.classes.values()) <= risk.threshold
    predict_scans(world.data, world.out.with_name("all"), settings=world.network)
    predict_scans(
        world.data, world.out, settings=replace(world.network, weights=target), reject="risk"
    )
    losses, rejected = dict[str, list[float]](), 0
    for file in find_scans(world.data):
        path = output_path(world.out.with_name("all"), file.sequence, "predictions", file.stem)
        every = space.to_train(read_labels(path))
        truth = space.to_train(read_labels(file.label_path))
        doubt = np.load(world.result(LEAST_CONFIDENCE, file.sequence, file.stem))
        kept = space.to_train(world.labels(file.sequence, file.stem))
        for label, name in enumerate(space.names):
            own = every == label
            above = doubt[own] > risk.classes.get(name, risk.threshold)
            np.testing.assert_array_equal(kept[own], np.where(above, 0, label))
            rejected += above.sum()
            if (judged := own & (truth > 0)).any():
                loss = (judged & (kept == label) & (truth != label)).sum() / judged.sum()
                losses.setdefault(name, []).append(loss)
    # (n mean + 1) / (n + 1) ≤ 0.4 of the n scans that have the label, if they are 2 or 3.
    own = {name for name, each in losses.items() if name != "unlabeled" and len(each) > 1}
    assert own == set(risk.classes)
    assert all((sum(losses[name]) + 1) / (len(losses[name]) + 1) <= 0.4 for name in own)
    found = evaluate(find_scans(world.data), world.out, space)
    assert found.accepted is not None
    assert plain(found.accepted) == tuned["kept"]
    results = [ResultFolder(world.out).read(file) for file in find_scans(world.data)]
    assert sum(each.rejected.sum() for each in results) == rejected > 0


def test_a_promise_that_does_not_hold_is_said(unsure_is_wrong: World, target, caplog) -> None:
    world, network = unsure_is_wrong, replace(unsure_is_wrong.network, weights=target)
    tuned = tune("risk", world.data, target, settings=world.network, selection=EVERY, at_most=0.6)
    assert tuned["unit"] == "drive"
    # By scans, (ΣL + 1) / 4 ≤ 0.6, more would be kept.
    losses = np.array(tuned["of_scans"])[:, 1]
    assert (losses[0] + losses[1:].mean() + 1) / 3 <= 0.6
    predict_scans(world.data, world.out, settings=network, reject="risk")
    assert "nothing is promised" not in caplog.text
    found = evaluate(find_scans(world.data), world.out, label_space()).guarantee
    assert found is not None
    assert (found.unit, found.units) == ("drive", 2)
    assert RISK_BOUND_EXCEEDED not in caplog.messages
    for file in find_scans(world.data):
        labels = world.labels(file.sequence, file.stem)
        write_labels(file.label_path, np.where(labels == 10, 40, 10).astype(np.uint32))
    evaluate(find_scans(world.data), world.out, label_space())
    assert RISK_BOUND_EXCEEDED in caplog.messages
    # A sensor that was fitted otherwise
    card = read_card(target)
    view = replace(card.risk.view, fov_up=card.risk.view.fov_up + 8)
    save_with_card(target, target, replace(card, risk=replace(card.risk, view=view)))
    predict_scans(world.data, world.out.with_name("o"), settings=network, reject="risk")
    assert "nothing is promised" in caplog.text
    # One of several sensors that the threshold was chosen on
    caplog.clear()
    several = replace(card.risk, view=view, other_views=(card.risk.view,))
    save_with_card(target, target, replace(card, risk=several))
    predict_scans(world.data, world.out.with_name("s"), settings=network, reject="risk")
    assert "nothing is promised" not in caplog.text


def test_a_curve_is_not_overwritten_unasked(world: World, target) -> None:
    curve = target.with_name(f"{target.stem}_risk.png")
    curve.write_bytes(b"precious")
    with pytest.raises(OutputError, match=r"_risk\.png"):
        tune("risk", world.data, target, settings=world.network, at_most=0.5)
    assert curve.read_bytes() == b"precious"


def test_a_full_disk_leaves_neither_weights_nor_curve(
    unsure_is_wrong: World, target, monkeypatch
) -> None:
    world = unsure_is_wrong

    def tuned() -> None:
        tune("risk", world.data, target, settings=world.network, selection=EVERY, at_most=0.5)

    full = Mock(side_effect=OutputError(target, "cannot be written: no space left"))
    with monkeypatch.context() as patch:
        patch.setattr("salsanext_cli.stages.tune.save_with_card", full)
        with pytest.raises(OutputError):
            tuned()
    curve = target.with_name(f"{target.stem}_risk.png")
    assert not target.exists()
    assert not curve.exists()
    tuned()
    assert target.exists()
    assert curve.exists()


def test_what_few_scans_cannot_promise(unsure_is_wrong: World, target) -> None:
    world = unsure_is_wrong

    def tuned(**numbers):
        tune("risk", world.data, target, settings=world.network, selection=EVERY, **numbers)

    with pytest.raises(TrainingError, match=r"no less than 25 % .* 16 more .* --at-most 25%"):
        tuned(at_most=0.05)
    with pytest.raises(TrainingError, match=r"no less than 54% of scans above .* 19 more"):
        tuned(at_most=0.05, confidence=0.9)
    with pytest.raises(UsageError, match=r"--at-most: 5 \(expected above 0"):
        tuned(at_most=5)
    with pytest.raises(UsageError, match=r"--confidence: 1\nhint: "):
        tuned(at_most=0.5, confidence=1)
    assert not target.exists()
    tuned(at_most=0.05, confidence=0.6)
    assert read_card(target).risk.confidence == 0.6


def test_scans_of_training_promise_nothing(unsure_is_wrong: World, target, tmp_path) -> None:
    world, known = unsure_is_wrong, tmp_path / "known.safetensors"
    digests = frozenset({scan_digest(read_scan(world.scan()))})
    card = replace(read_card(world.network.weights), trained_on=digests)
    save_with_card(world.network.weights, known, card)
    network = replace(world.network, weights=known)
    tuned = tune("risk", world.data, target, settings=network, selection=EVERY, at_most=0.4)
    assert (tuned["scans"], tuned["skipped"]) == (2, 1)


def test_copies_of_a_scan_promise_nothing(unsure_is_wrong: World, target, caplog) -> None:
    world = unsure_is_wrong
    for file in find_scans(world.data)[1:]:
        shutil.copy(find_scans(world.data)[0].path, file.path)
        shutil.copy(find_scans(world.data)[0].label_path, file.label_path)
    tuned = tune("risk", world.data, target, settings=world.network, selection=EVERY, at_most=0.6)
    assert (tuned["scans"], tuned["skipped"]) == (1, 2)
    assert "2 scans skipped" in caplog.text


def test_an_error_that_was_fitted_to_these_scans_is_said(
    unsure_is_wrong: World, target, tmp_path, caplog, monkeypatch
) -> None:
    monkeypatch.setattr(error, "MIN_STEPS", 1)
    monkeypatch.setattr(error, "gains", lambda model: True)
    world, fitted = unsure_is_wrong, tmp_path / "fitted.safetensors"
    tune("error", world.data, fitted, settings=world.network, selection=ScanSelection("valid"))
    network = replace(world.network, weights=fitted)
    tune("risk", world.data, target, settings=network, selection=EVERY, at_most=0.6)
    assert "the error was fitted to 08 too" in caplog.text


@pytest.mark.parametrize(("confidence", "is_above"), [(None, False), (0.9, True)])
def test_a_drive_left_out_is_judged_by_what_is_promised(confidence, is_above) -> None:
    losses = np.where(np.arange(44) < 35, 0.0, 0.06)  # Nine of 22 scans of the second drive
    kept = np.stack([np.ones(44), losses], axis=1)[..., None]
    sequences, numbers = np.repeat(["a", "b"], 22), RiskLevel(0.05, confidence)
    of_b = _left_out(kept, sequences, np.arange(44), numbers)[1]
    assert of_b.above == pytest.approx(9 / 22)
    assert of_b.exceeds(numbers) == is_above


def test_a_void_threshold_is_refused(unsure_is_wrong: World, target, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(error, "MIN_STEPS", 1)
    monkeypatch.setattr(error, "gains", lambda model: True)
    world = unsure_is_wrong
    with pytest.raises(WeightsError, match=r"no threshold of risk .* `salsanext tune risk"):
        predict_scans(world.data, world.out, settings=world.network, reject="risk")
    tune("risk", world.data, target, settings=world.network, selection=EVERY, at_most=0.3)
    network = replace(world.network, weights=target)
    coarse = replace(network, classes=label_space("coarse"))
    with pytest.raises(UsageError, match=r"--classes: .*guarantee .* does not cover other labels"):
        predict_scans(world.data, world.out, settings=coarse, reject="risk")
    with pytest.raises(UsageError, match=r"--knn-…: "):
        predict_scans(
            world.data, world.out, settings=network, knn=KnnParameters(k=3), reject="risk"
        )
    card = read_card(target)
    others = {"min_range": 2.0, "ego": "none", "sensor": replace(card.sensor, fov_up=4.0)}
    for name, value in others.items():
        other = replace(network, **{name: value})
        with pytest.raises(UsageError, match=f"--{name.replace('_', '-')}: .*other labels"):
            predict_scans(world.data, world.out, settings=other, reject="risk")
    assert not world.out.exists()
    # Another error or another temperature is another uncertainty.
    for part in ("error", "temperature"):
        other = tmp_path / f"{part}.safetensors"
        tune(part, world.data, other, settings=network, selection=EVERY)
        assert not read_card(other).risk


def test_a_run_says_how_many_labels_it_expects_to_be_right(world: World, tmp_path) -> None:
    card, weights = read_card(world.network.weights), tmp_path / "line.safetensors"
    line = AccuracyLine(1.0, 0.0, 0.05)
    save_with_card(world.network.weights, weights, replace(card, accuracy=line))
    network = replace(world.network, weights=weights)
    summary = predict_scans(world.data, world.out, settings=network).summary
    doubts = [
        np.nanmean(np.load(world.result(LEAST_CONFIDENCE, file.sequence, file.stem)))
        for file in find_scans(world.data)
    ]
    assert summary is not None
    estimate = summary.expected_accuracy()
    assert estimate.accuracy == pytest.approx(1 - np.mean(doubts), abs=1e-3)
    assert expected_of_run(world.out, read_run(world.out)[0].rows) == estimate
    plain = predict_scans(world.data, tmp_path / "plain", settings=world.network).summary
    assert plain is not None
    assert plain.expected_accuracy() is None
    # A key that older folders lack would refuse them.
    assert Manifest(tmp_path / "plain").settings("predict").accuracy is None
