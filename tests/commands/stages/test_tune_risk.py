# SPDX-License-Identifier: MIT
"""Stage `tune risk`, and what `predict --reject risk` and `eval` make of its threshold."""

import json
import logging
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scans import refused, write_weights
from shallow_network import shallow  # noqa: F401
from world import World

from salsanext_cli import label_space, read_labels, write_labels
from salsanext_cli.commands.evaluation import Evaluation
from salsanext_cli.commands.stages.evaluate import evaluate_scans
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.report import read_run, report
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.errors import (
    NoInputError,
    OutputError,
    TrainingError,
    UsageError,
    WeightsError,
)
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.measures.risk_control import RISK_BOUND_EXCEEDED
from salsanext_cli.core.network.card import AccuracyLine, RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.plain_data import plain
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.fit.threshold_settings import setting_as_typed
from salsanext_cli.runs.loop.run import Outcome
from salsanext_cli.runs.results.folder_names import LEAST_CONFIDENCE
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.summary.threshold_scans import EARLY, NOT_COMPARED
from salsanext_cli.training.tuning.risk import ShareTable, held_out_sequences
from salsanext_cli.training.tuning.risk_level import FewUnits, RiskLevel

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


def label_unsure_points_wrongly(world: World) -> World:
    """Label all scans as the network does, except the half with the lowest confidence."""
    predicted = world.out.with_name("predicted")
    predict_scans(world.data, predicted, settings=world.network)
    for path in predicted.rglob("predictions/*.label"):
        labels = read_labels(path).copy()
        doubt = np.load(path.parent.parent / LEAST_CONFIDENCE / f"{path.stem}.npy")
        wrong = doubt > np.nanmedian(doubt)
        labels[wrong] = np.where(labels[wrong] == 10, 40, 10)
        sequence = path.parent.parent.name
        write_labels(world.data / "sequences" / sequence / "labels" / path.name, labels)
    return world


@pytest.fixture
def unsure_is_wrong(world: World) -> World:
    return label_unsure_points_wrongly(world)


@dataclass(frozen=True, kw_only=True)
class RejectedRun:
    """A threshold, and a run on its scans that rejects the labels above it."""

    world: World
    target: Path
    """Weights with the threshold."""
    tuned: Any
    """Report of `tune risk`."""
    risk: RiskThreshold
    outcome: Outcome
    messages: list[str]
    """What the run logged."""

    @property
    def scans(self) -> list[ScanFile]:
        return find_scans(self.world.data)

    def above(self, scan: ScanFile) -> np.ndarray:
        """Return which points of a scan are above the threshold."""
        doubt = np.load(self.world.result(LEAST_CONFIDENCE, scan.sequence, scan.stem))
        return doubt > self.risk.threshold

    def losses(self) -> list[float]:
        """Return the share of accepted and wrong points of each scan."""
        losses = []
        for scan in self.scans:
            truth = SPACE.to_train(read_labels(scan.label_path))
            predicted = SPACE.to_train(self.world.labels(scan.sequence, scan.stem))
            wrong = (predicted > 0) & (truth > 0) & (predicted != truth)
            losses.append(wrong.sum() / (truth > 0).sum())
        return losses

    def judged(self) -> Evaluation:
        """Return what `eval` makes of the run."""
        return evaluate_scans(self.scans, self.world.out, SPACE)


class Messages(logging.Handler):
    """Texts of all messages of a run."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> RejectedRun:
    folder = tmp_path_factory.mktemp("risk")
    world = label_unsure_points_wrongly(World.made(folder, weights).unfitted())
    target = folder / "tuned.safetensors"
    tuned = world.tune("risk", target, at_most=0.3)
    network = replace(world.network, weights=target)
    logger, messages = logging.getLogger("salsanext_cli"), Messages()
    level = logger.level
    logger.addHandler(messages)
    logger.setLevel("INFO")
    outcome = predict_scans(world.data, world.out, settings=network, reject="risk")
    logger.removeHandler(messages)
    logger.setLevel(level)
    return RejectedRun(
        world=world,
        target=target,
        tuned=tuned,
        risk=read_card(target).risk,
        outcome=outcome,
        messages=messages.texts,
    )


def test_the_card_has_the_threshold_that_is_reported(run):
    recorded = plain(run.risk)
    assert recorded == {key: run.tuned[key] for key in recorded}
    assert describe_weights(run.target).card.risk == run.risk


def test_the_threshold_states_level_and_scans(run):
    recorded = plain(run.risk)
    expected = {"kind": "least_confidence", "at_most": 0.3, "confidence": None, "scans": 3}
    assert recorded.items() >= {**expected, "sequences": ["00", "08"]}.items()
    assert [part["sequence"] for part in run.tuned["held_out"]] == ["00", "08"]


def test_the_curve_passes_through_the_threshold(run):
    """Its mean shares at the threshold are those that the run accepts, within a percent."""
    accepted, wrong = (np.array(run.tuned["curve"][key]) for key in ("accepted", "wrong"))
    assert (np.diff(accepted) > 0).all()
    assert (np.diff(wrong) >= 0).all()
    mean_accepted, mean_wrong = np.mean(run.tuned["of_scans"], axis=0)
    assert np.interp(mean_accepted, accepted, wrong) == pytest.approx(mean_wrong, abs=0.02)
    assert 90 < len(accepted) <= 101


def test_the_picture_is_beside_the_weights_and_replaces_nothing(run, tmp_path):
    picture = run.target.with_name("tuned_risk.png")
    assert run.tuned["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    target = tmp_path / "other.safetensors"
    (tmp_path / "other_risk.png").write_bytes(b"mine")
    with refused(OutputError, tmp_path / "other_risk.png"):
        run.world.tune("risk", target, at_most=0.3)
    assert not target.exists()


def test_labels_above_the_threshold_are_rejected(run):
    rejected = 0
    for scan in run.scans:
        above = run.above(scan)
        assert not run.world.labels(scan.sequence, scan.stem)[above].any()
        rejected += above.sum()
    assert run.outcome.rejected_points == rejected > 0


def test_accepted_and_wrong_points_keep_to_the_level(run):
    labels = run.judged().accepted
    # (3 R + 1) / 4 ≤ 0.3, thus R ≤ 1 / 15, with no finer step than a bin
    assert 0 < 15 * labels.wrong <= labels.points


def test_eval_gives_the_numbers_that_were_reported_for_the_threshold(run):
    judged, losses = run.judged(), run.losses()
    numbers = {"units": 3, "above": sum(loss > 0.3 for loss in losses), "at_most": 0.3}
    numbers |= {"mean": pytest.approx(np.mean(losses)), "worst": pytest.approx(max(losses))}
    numbers |= {"confidence": None, "unit": "scan", "are_others": False, "consecutive": False}
    # Three scans and three others have 20 divisions.
    numbers |= {"incomparable": "3 scans"}
    numbers["scope"] = run.tuned["guarantee"].partition(", for ")[2]
    assert judged.to_dict()["rejection"]["guarantee"] == numbers
    assert plain(judged.accepted) == run.tuned["accepted"]


def test_run_and_page_state_the_guarantee(run):
    judged = run.judged()
    assert run.tuned["guarantee"] in "".join(run.messages)
    page = report(run.world.out).page.read_text("utf-8")
    assert f"<dd>{run.tuned['guarantee']}</dd>" in page
    sentences = (judged.guarantee.sentence, *judged.accepted.sentences)
    assert all(sentence[1:] in page for sentence in sentences)


def test_scans_that_the_threshold_was_chosen_on_are_named_and_are_not_unlike_them(run, caplog):
    run.judged()
    assert "the threshold was chosen on 3 of 3 scans" in caplog.text
    assert not any(WarningCode.OTHER_SCANS in message for message in run.messages)


def test_the_guarantee_does_not_cover_merged_classes(run):
    folder = ResultFolder(run.world.out)
    scans, coarse = folder.predicted(ALL, classes=label_space("coarse"))
    assert evaluate_scans(scans, run.world.out, coarse).guarantee is None


def test_accepted_labels_need_no_uncertainty(run, tmp_path):
    first, last = run.scans[0], run.scans[-1]
    out = tmp_path / "copy"
    shutil.copytree(run.world.out, out)
    output_path(out, last.sequence, LEAST_CONFIDENCE, last.stem).unlink()
    assert evaluate_scans(run.scans, out, SPACE).guarantee == run.judged().guarantee
    results = ResultFolder(out).read(first, truth_in=(SPACE, SPACE))
    assert results.rejected.sum() == run.above(first).sum()


def test_a_guarantee_that_does_not_hold_warns(unsure_is_wrong: World, target, caplog) -> None:
    world, network = unsure_is_wrong, replace(unsure_is_wrong.network, weights=target)
    tuned = world.tune("risk", target, at_most=0.6)
    assert tuned["unit"] == "drive"
    # By scans, (ΣL + 1) / 4 ≤ 0.6, more would be kept.
    losses = np.array(tuned["of_scans"])[:, 1]
    assert (losses[0] + losses[1:].mean() + 1) / 3 <= 0.6
    predict_scans(world.data, world.out, settings=network, reject="risk")
    assert WarningCode.OTHER_SCANS not in caplog.text
    check = evaluate_scans(find_scans(world.data), world.out, label_space()).guarantee
    assert (check.unit, check.units) == ("drive", 2)
    assert RISK_BOUND_EXCEEDED not in caplog.messages
    for file in find_scans(world.data):
        labels = world.labels(file.sequence, file.stem)
        write_labels(file.label_path, np.where(labels == 10, 40, 10).astype(np.uint32))
    evaluate_scans(find_scans(world.data), world.out, label_space())
    assert RISK_BOUND_EXCEEDED in caplog.messages
    # A sensor that was fitted otherwise
    card = read_card(target)
    (view,) = card.risk.views
    other = replace(view, fov_up=view.fov_up + 8)
    save_with_card(target, target, replace(card, risk=replace(card.risk, views=(other,))))
    predict_scans(world.data, world.out.with_name("o"), settings=network, reject="risk")
    assert WarningCode.OTHER_SCANS in caplog.text
    check = evaluate_scans(
        find_scans(world.data), world.out.with_name("o"), label_space()
    ).guarantee
    assert check.are_others
    assert "not guaranteed" in check.sentence
    # One of several sensors that the threshold was chosen on
    caplog.clear()
    several = replace(card.risk, views=(other, view))
    save_with_card(target, target, replace(card, risk=several))
    predict_scans(world.data, world.out.with_name("s"), settings=network, reject="risk")
    assert WarningCode.OTHER_SCANS not in caplog.text


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ({"at_most": 0.05}, ("25 %", "16 more", "at_most=0.4,")),
        ({"at_most": 0.05, "confidence": 0.9}, ("54 % of scans", "19 more", "lower confidence")),
    ],
)
def test_too_few_scans_for_a_guarantee_are_refused(world: World, target, numbers, expected) -> None:
    with pytest.raises(TrainingError) as caught:
        world.tune("risk", target, **numbers)
    error = caught.value
    texts = (error.problem, error.expected, error.hint)
    assert all(part in text for part, text in zip(expected, texts, strict=True))


def test_scans_without_labels_are_named_as_such(world: World, target) -> None:
    (world.data / "sequences/08").rename(world.data / "sequences/mine")
    for labels in (world.data / "sequences").glob("*/labels"):
        shutil.rmtree(labels)
    given = {"at_most": 0.6, "selection": ScanSelection()}
    error = refused(NoInputError, world.data, world.tune, "risk", target, **given).value
    assert error.problem == "has no labels"


def test_classes_of_which_no_threshold_was_chosen_are_omitted(unsure_is_wrong, target) -> None:
    world = unsure_is_wrong
    world.tune("risk", target, at_most=0.6)
    coarse = replace(world.network, weights=target, classes=label_space("coarse"))
    given = {"settings": coarse, "reject": "risk"}
    error = refused(UsageError, "classes", predict_scans, world.data, world.out, **given).value
    assert error.hint == "omit classes"


def test_impossible_levels_are_refused(unsure_is_wrong: World, target) -> None:
    levels = {"at_most": {"at_most": 5}, "confidence": {"at_most": 0.5, "confidence": 1}}
    for option, numbers in levels.items():
        refused(UsageError, option, unsure_is_wrong.tune, "risk", target, **numbers)
    assert not target.exists()
    unsure_is_wrong.tune("risk", target, at_most=0.05, confidence=0.6)
    assert read_card(target).risk.confidence == 0.6


@pytest.mark.usefixtures("in_few_steps")
def test_an_error_that_was_fitted_to_these_scans_warns(unsure_is_wrong, target, tmp_path, caplog):
    world, fitted = unsure_is_wrong, tmp_path / "fitted.safetensors"
    world.tune("error", fitted, selection=ScanSelection("valid"))
    network = replace(world.network, weights=fitted)
    fit = world.tune("risk", target, settings=network, at_most=0.6)
    warned = [warning for warning in fit["warnings"] if warning["code"] == WarningCode.SEEN_BY_FIT]
    assert [warning["scans"] for warning in warned] == [["08"]]
    assert caplog.text.count(f"({WarningCode.SEEN_BY_FIT})") == 1


@pytest.mark.parametrize(("confidence", "is_above"), [(None, False), (0.9, True)])
def test_a_held_out_drive_is_judged_by_the_guarantee(confidence, is_above) -> None:
    losses = np.where(np.arange(44) < 35, 0.0, 0.06)  # Nine of 22 scans of the second drive
    shares = ShareTable(
        accepted=np.ones((44, 1)),
        wrong=losses[:, None],
        sequences=np.repeat(["a", "b"], 22),
        units=np.arange(44),
    )
    level = RiskLevel(at_most=0.05, confidence=confidence)
    drive = held_out_sequences(shares, level)[1]
    assert drive.above == pytest.approx(9 / 22)
    assert drive.exceeds(level) == is_above


@pytest.mark.usefixtures("in_few_steps")
def test_a_void_threshold_is_refused(unsure_is_wrong: World, target, tmp_path) -> None:
    # A sensor that is stated leaves no room for a minimum range.
    fitted = replace(unsure_is_wrong.network, sensor="auto")
    world = replace(unsure_is_wrong, network=fitted)
    with pytest.raises(WeightsError) as caught:
        predict_scans(world.data, world.out, settings=world.network, reject="risk")
    assert "`salsanext tune risk" in caught.value.hint
    world.tune("risk", target, at_most=0.3)
    network = replace(world.network, weights=target)
    coarse = replace(network, classes=label_space("coarse"))
    card = read_card(target)
    others = {"min_range": 2.0, "ego": "none", "sensor": replace(card.sensor, fov_up=4.0)}
    runs = {name: {"settings": replace(network, **{name: others[name]})} for name in others}
    runs["classes"] = {"settings": coarse}
    runs["knn"] = {"settings": network, "knn": KnnParameters(k=3)}
    for name, options in runs.items():
        with refused(UsageError, name) as caught:
            predict_scans(world.data, world.out, reject="risk", **options)
        assert not {"None", "[]", "''"} & {*re.split("[ ,]+", caught.value.problem)}
    assert not world.out.exists()
    # Another error or another temperature is another uncertainty.
    for part in ("error", "temperature"):
        other = tmp_path / f"{part}.safetensors"
        world.tune(part, other, settings=network)
        assert not read_card(other).risk


@pytest.mark.parametrize(
    ("name", "value", "typed"),
    [
        ("ego", None, "auto"),
        ("ego", [], "none"),
        ("ego", [-1.5, -1.0, -2.0, 2.0, 1.0, 0.5], "-1.5,-1,-2,2,1,0.5"),
        ("intensity", "", "raw"),
        ("intensity", "match", "match"),
        ("min_range", None, "the default"),
        ("min_range", 2.0, "2"),
        ("precision", "int8", "int8"),
        ("width", 512, "512"),
    ],
)
def test_settings_are_named_as_they_are_typed(name, value, typed) -> None:
    assert setting_as_typed(name, value) == typed


def test_a_run_estimates_its_accuracy(world: World, tmp_path) -> None:
    card, weights = read_card(world.network.weights), tmp_path / "line.safetensors"
    line = AccuracyLine(1.0, 0.0, 0.05)
    save_with_card(world.network.weights, weights, replace(card, accuracy=line))
    network = replace(world.network, weights=weights)
    summary = predict_scans(world.data, world.out, settings=network).summary
    doubts = [
        np.nanmean(np.load(world.result(LEAST_CONFIDENCE, file.sequence, file.stem)))
        for file in find_scans(world.data)
    ]
    estimate = summary.expected_accuracy()
    assert estimate.accuracy == pytest.approx(1 - np.mean(doubts), abs=1e-3)
    assert read_run(world.out)[0].expected_accuracy() == estimate
    plain = predict_scans(world.data, tmp_path / "plain", settings=world.network).summary
    assert plain.expected_accuracy() is None
    # A key that older folders lack would refuse them.
    assert Manifest(tmp_path / "plain").settings("predict").accuracy is None


def test_few_scans_say_what_the_bound_leaves_and_what_more_would_accept(
    unsure_is_wrong: World, target, caplog
) -> None:
    """Three scans at 30 %: (3 L + 1) / 4 ≤ 0.3 leaves L ≤ 1/15; six leave 11/60."""
    world = unsure_is_wrong
    seen = []
    tuned = world.tune(
        "risk", target, at_most=0.3, progress=lambda *_: seen.append(len(caplog.messages))
    )
    before, after = (text for text in caplog.messages if text.startswith("3 scans: "))
    assert before in caplog.messages[: seen[0]]
    assert "6.7 % of the points" in before
    assert "6 scans 18.3 %" in before
    few = tuned["few"]
    assert few["left"] == pytest.approx(1 / 15)
    assert few["useful"] == 6
    accepted = tuned["accepted"]["accepted"] / tuned["accepted"]["points"]
    assert accepted < few["accepted_by_useful"]
    assert f"{100 * accepted:.1f} %" in after
    assert f"{100 * few['accepted_by_useful']:.0f} %" in after
    # With a level that leaves the same room, the same threshold is chosen.
    level = (3 * 11 / 60 + 1) / 4
    shares = world.tune("risk", target, at_most=level, overwrite=True)["accepted"]
    assert few["accepted_by_useful"] == pytest.approx(shares["accepted"] / shares["points"])


def test_enough_scans_do_not_warn(unsure_is_wrong: World, target, caplog) -> None:
    assert unsure_is_wrong.tune("risk", target, at_most=0.5)["few"] is None
    assert not [text for text in caplog.messages if text.startswith("3 scans: ")]


@pytest.mark.parametrize(
    ("count", "level", "numbers"),
    [
        (9, RiskLevel(at_most=0.1), (0, 18)),
        (12, RiskLevel(at_most=0.1), (0.3 / 12, 18)),
        (19, RiskLevel(at_most=0.05), (0, 38)),
        (22, RiskLevel(at_most=0.1, confidence=0.9), (0, 38)),
        (18, RiskLevel(at_most=0.1), None),
        (38, RiskLevel(at_most=0.05, confidence=0.9), None),
    ],
)
def test_what_few_scans_leave_by_hand(count, level, numbers, caplog) -> None:
    few = FewUnits.among(count, "scan", level)
    assert (few is None) == (numbers is None)
    if few:
        assert (few.left, few.useful) == (pytest.approx(numbers[0], abs=1e-9), numbers[1])
        few.warn_before()
        assert f"{numbers[1]} scans" in caplog.messages[0]
        assert str(numbers[1] - count) in caplog.messages[0].partition("hint: ")[2]


def test_scans_with_other_classes_are_not_covered(unsure_is_wrong: World, target, caplog) -> None:
    world = unsure_is_wrong
    world.tune("risk", target, at_most=0.3)
    card = read_card(target)
    # The population of another place: one class covers most of it, as in no scan of the world.
    shares = (0.0,) * 18 + (1.0,)
    elsewhere = tuple(
        UnitTraits(unit=str(number), uncertainty=0.001, class_shares=shares)
        for number in range(400)
    )
    save_with_card(target, target, replace(card, risk=replace(card.risk, population=elsewhere)))
    network = replace(world.network, weights=target)
    predict_scans(world.data, world.out, settings=network, reject="risk")
    assert WarningCode.OTHER_SCANS in caplog.text
    check = evaluate_scans(find_scans(world.data), world.out, label_space()).guarantee
    assert check.are_others
    assert "the guarantee does not cover these scans" in caplog.text
    # Weights of early versions have no population.
    caplog.clear()
    save_with_card(target, target, replace(card, risk=replace(card.risk, population=())))
    predict_scans(world.data, world.out.with_name("early"), settings=network, reject="risk")
    assert WarningCode.OTHER_SCANS not in caplog.text


def test_scans_of_other_drives_are_not_those_of_the_threshold(
    unsure_is_wrong: World, target, caplog
) -> None:
    world = unsure_is_wrong
    world.tune("risk", target, at_most=0.3)
    card, network = read_card(target), replace(world.network, weights=target)
    changes = {"data-set": {"data_set": "another"}, "drive": {"sequences": ("00",)}}
    for name, change in changes.items():
        caplog.clear()
        save_with_card(target, target, replace(card, risk=replace(card.risk, **change)))
        out = world.out.with_name(name)
        predict_scans(world.data, out, settings=network, reject="risk")
        assert WarningCode.OTHER_SCANS in caplog.text
        check = evaluate_scans(find_scans(world.data), out, label_space()).guarantee
        assert "not guaranteed" in check.sentence


def test_a_run_with_a_threshold_of_an_early_version_continues(unsure_is_wrong: World, target):
    """Its record says nothing about consecutive scans."""
    world = unsure_is_wrong
    assert world.tune("risk", target, at_most=0.6)["consecutive"] is None
    settings = {"settings": replace(world.network, weights=target), "reject": "risk"}
    predict_scans(world.data, world.out, **settings)
    record = world.out / "predict.json"
    content = json.loads(record.read_text())
    content["settings"]["guarantee"].pop("consecutive", None)
    record.write_text(json.dumps(content))
    again = predict_scans(world.data, world.out, **settings)
    assert again.done == 0


def test_a_threshold_of_consecutive_scans_is_not_called_guaranteed(
    unsure_is_wrong: World, target, caplog
) -> None:
    world = unsure_is_wrong
    caplog.set_level("INFO")
    neighbours = ScanSelection(sequences=("08",))
    tuned = world.tune("risk", target, at_most=0.6, selection=neighbours)
    assert tuned["consecutive"]
    assert [warning["code"] for warning in tuned["warnings"]] == [WarningCode.CONSECUTIVE]
    assert read_card(target).risk.consecutive
    network = replace(world.network, weights=target)
    caplog.clear()
    settings = {"settings": network, "reject": "risk", "selection": neighbours}
    predict_scans(world.data, world.out, **settings)
    assert "not guaranteed" in caplog.text
    judged = evaluate_scans(ResultFolder(world.out).scans(), world.out, label_space())
    assert "not guaranteed" in judged.guarantee.sentence
    # The scans are those of the threshold, so others are judged.
    doubt = replace(judged, counts=replace(judged.counts, threshold_scans=0)).guarantee_doubt
    assert WarningCode.CONSECUTIVE in doubt


def test_too_few_scans_to_compare_are_not_called_guaranteed(
    unsure_is_wrong: World, target, caplog
) -> None:
    world = unsure_is_wrong
    caplog.set_level("INFO")
    tuned = world.tune("risk", target, at_most=0.3)
    assert all(unit["measures"] for unit in tuned["population"])
    network = replace(world.network, weights=target)
    predict_scans(world.data, world.out, settings=network, reject="risk")
    judged = evaluate_scans(find_scans(world.data), world.out, label_space())
    assert "guaranteed" not in judged.guarantee.sentence
    assert "3 scans" in judged.guarantee.sentence
    assert f"{NOT_COMPARED} (3 scans)" in caplog.text
    # The line of a threshold of an early version says that the sensor was not compared.
    card = read_card(target)
    early = tuple(replace(unit, measures=()) for unit in card.risk.population)
    save_with_card(target, target, replace(card, risk=replace(card.risk, population=early)))
    out = world.out.with_name("early")
    predict_scans(world.data, out, settings=network, reject="risk")
    check = evaluate_scans(find_scans(world.data), out, label_space()).guarantee
    assert "guaranteed" not in check.sentence
    assert check.incomparable == EARLY
