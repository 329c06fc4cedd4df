# SPDX-License-Identifier: MIT
import json
import logging
import shutil

import numpy as np
import pytest
import yaml
from evaluation_runs import CAR, MOVING_CAR, ROAD, SPACE, UNKNOWN, World
from scans import files_below, refused

from salsanext_cli.commands.stages.evaluate import (
    evaluate,
    evaluate_scans,
    part_of,
    plan_evaluation,
)
from salsanext_cli.core.errors import LabelError, NoInputError, OutputError
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def iou(evaluation, name):
    return next(c.iou for c in evaluation.scores.classes if c.name == name)


@pytest.mark.real
def test_the_file_is_the_official_evaluators(real_data, tmp_path):
    shutil.copytree(real_data / "golden/evaluation/sequences", tmp_path / "out/sequences")
    scans = find_scans(real_data / "data/semantickitti", ["08"])
    evaluation = evaluate_scans(scans, tmp_path / "out", SPACE)
    expected = (real_data / "golden/evaluation/scores.txt").read_bytes()
    assert (tmp_path / "out/scores.txt").read_bytes() == expected
    assert evaluation.counts.scans == 3


def test_scans_of_several_sequences_are_pooled(world):
    # Instances, and moving classes, are not compared.
    world.add("000000", [CAR, CAR | 1234 << 16, ROAD], [MOVING_CAR, ROAD, ROAD], "08")
    world.add("000000", [MOVING_CAR], [CAR | 1 << 16], "09")
    evaluation = world.evaluate()
    assert iou(evaluation, "car") == pytest.approx(2 / 3)
    assert iou(evaluation, "road") == pytest.approx(1 / 2)
    assert evaluation.scores.points == 4
    assert evaluation.counts.scans == 2


def test_unknown_ids_are_counted_as_unlabelled(world, caplog):
    road = [ROAD] * 8
    world.add("000000", [CAR, CAR, UNKNOWN | 5 << 16, *road], [CAR, UNKNOWN, CAR, *road])
    world.add("000001", [CAR, UNKNOWN, *road], [65535, CAR, *road])
    with caplog.at_level(logging.WARNING):
        evaluation = world.evaluate()
    assert evaluation.counts.unknown_truth == {UNKNOWN: 2}
    assert iou(evaluation, "car") == pytest.approx(1 / 3)
    assert "77 (1×), 65535 (1×)" in caplog.text
    assert "77 (2×)" in caplog.text
    report = json.loads((world.out / "eval.json").read_text())
    assert report["unknown_ids"] == {"truth": {"77": 2}, "predictions": {"77": 1, "65535": 1}}


def test_ids_of_something_else_are_refused(world):
    """A few of nuScenes' ids are SemanticKITTI's of other things; so are a few train ids."""
    nuscenes, right = [24, 24, 28, 28, 30, 17, 0], [ROAD, ROAD, CAR, CAR, CAR, CAR, 0]
    world.add("000000", 10 * right, 10 * nuscenes)
    refused(NoInputError, world.out, world.evaluate)
    assert not (world.out / "eval.json").exists()
    # One such scan is a failure.
    world.add("000001", right, right)
    evaluation = world.evaluate()
    assert evaluation.counts.scans == 1
    assert "83 %" in evaluation.failures[0].reason


def test_bad_scans_are_named_and_the_others_are_scored(world):
    for i in range(5):
        truth = [CAR, ROAD] if i != 1 else None
        world.add(f"{i:06d}", truth, [CAR, ROAD] if i != 3 else [CAR])
    truncated = world.dataset / "sequences/08/labels/000002.label"
    truncated.write_bytes(truncated.read_bytes()[:3])
    evaluation = world.evaluate()
    assert evaluation.counts.scans == 2
    stems = [failure.scan.stem for failure in evaluation.failures]
    assert stems == ["000001", "000002", "000003"]
    report = json.loads((world.out / "eval.json").read_text())
    assert report["failures"][-1]["scan"].endswith("000003.bin")


def test_no_scores_without_a_scan_that_can_be_compared_or_labels_of_a_sequence(world):
    world.add("000000", [CAR, ROAD], [CAR])
    refused(NoInputError, world.out, world.evaluate)
    world.add("000001", [CAR], [CAR])
    with refused(LabelError, output_path(world.out, "08", "predictions", "000000")):
        world.evaluate(on_error="stop")
    assert not (world.out / "scores.txt").exists()
    world.add("000000", None, [CAR], "11")
    refused(LabelError, world.dataset / "sequences/11/labels", world.evaluate)


def test_distance_bands(world):
    world.add("000000", [CAR, CAR], [CAR, CAR], distance=5)
    world.add("000001", [CAR, CAR], [CAR, ROAD], distance=35)
    world.add("000002", [CAR], None)
    world.add("000003", [], [])
    world.add("000004", [CAR], [CAR])
    folder = world.dataset / "sequences/08/velodyne"
    shutil.copy(folder / "000000.bin", folder / "000004.bin")
    evaluation = world.evaluate(by_distance=True)
    assert [failure.scan.stem for failure in evaluation.failures] == ["000003", "000004"]
    bands = evaluation.by_distance
    assert bands["0–10 m"].accuracy == 1
    assert bands["30–40 m"].accuracy == 0.5
    assert [band.points for band in bands.values()] == [2, 0, 0, 2, 0, 0]


@pytest.mark.drawn
def test_files_are_complete_and_replace_earlier_ones(world):
    world.add("000000", [CAR], [CAR])
    world.evaluate(by_distance=True)
    # An evaluation with probabilities wrote it.
    OwnedFolder(world.out).write(world.out / "eval_reliability.png", b"PNG")
    world.add("000001", [CAR], [ROAD])
    world.evaluate(by_distance=True)
    names = {path.name for path in world.out.iterdir() if path.is_file()}
    assert names == {"scores.txt", "eval.json", "eval_iou.png", "eval_confusion.png"}
    assert yaml.safe_load((world.out / "scores.txt").read_text())["iou_car"] == pytest.approx(0.5)
    report = json.loads((world.out / "eval.json").read_text())
    assert report["stage"] == "eval"
    assert report["scans"] == 2
    assert report["label_space"] == SPACE.name
    assert report["scores"]["points"] == 2
    band = report["by_distance"]["0–10 m"]
    assert (band["points"], band["iou_mean_same"], band["absent"]) == (2, 0.5, [])
    assert report["by_distance"]["over 50 m"]["absent"] == ["car"]
    assert np.sum(report["confusion"]) == 2
    assert report["classes"] == list(SPACE.names)


@pytest.mark.parametrize("name", ["scores.txt", "eval_reliability.png"])
def test_foreign_files_stay(world, name):
    world.add("000000", [CAR], [CAR])
    (world.out / name).write_text("mine")
    before = files_below(world.out)
    refused(OutputError, world.out / name, world.evaluate, by_distance=True)
    assert files_below(world.out) == before


def test_scores_of_each_scan_and_sequence(world):
    world.add("000000", [CAR, CAR, ROAD], [CAR, ROAD, ROAD], "08")
    world.add("000001", [CAR], [CAR], "08")
    world.add("000000", [ROAD], [CAR], "09")
    data = world.evaluate().to_dict()
    assert data["by_scan"]["08/000000"] == {
        "points": 3,
        "accuracy": pytest.approx(2 / 3),
        "iou_mean_present": pytest.approx(0.5),
    }
    assert [data["by_scan"][name]["accuracy"] for name in ("08/000001", "09/000000")] == [1, 0]
    assert [data["by_sequence"][name]["accuracy"] for name in ("08", "09")] == [3 / 4, 0]


def test_scans_that_are_gone_are_named_once(world, caplog):
    for stem in ("000000", "000001"):
        world.add(stem, [CAR], [CAR])
    find_scans(world.dataset)[0].path.unlink()
    for run in (evaluate, plan_evaluation):
        run(world.out, query=ResultQuery(world.dataset))
        assert caplog.text.count("1 scan with results skipped") == 1
        caplog.clear()


def test_a_part_is_evaluated_in_a_folder_below(world):
    world.add("000000", [CAR], [CAR], "08")
    world.add("000000", [ROAD], [CAR], "09")
    world.evaluate()
    before = {name: (world.out / name).read_bytes() for name in ("scores.txt", "eval.json")}
    scans = find_scans(world.dataset)
    listed = ResultFolder(world.out, world.dataset).scans()
    part = part_of(listed, scans[:1], ScanSelection(sequences=("08",)))
    evaluation = evaluate_scans(scans[:1], world.out, SPACE, part=part)
    assert evaluation.folder == world.out / "eval/08"
    assert json.loads((world.out / "eval/08/eval.json").read_text())["scores"]["accuracy"] == 1
    assert {name: (world.out / name).read_bytes() for name in before} == before
    assert part_of(listed, scans, ScanSelection(sequences=("08", "09"))) == ""
    assert part_of(listed, scans, ScanSelection(limit=1)) == "08-first-1"
    assert part_of(listed, scans[:1], ScanSelection(split="valid", limit=1)) == ""
    world.add("000000", [ROAD], [CAR], "08-09")
    scans = find_scans(world.dataset)
    names = [part_of(scans, some, ScanSelection(limit=9)) for some in (scans[::2], scans[1:2])]
    assert names == ["08,09-first-9", "08-09-first-9"]
    for number in range(20):
        world.add("000000", [ROAD], [CAR], f"a long name of a sequence {number}")
    scans = find_scans(world.dataset)
    for chosen in (scans[1:], scans[2:]):
        assert len(part_of(scans, chosen, ScanSelection(sequences=("x",)))) < 60
    (world.out / "eval/08/scores.txt").write_text("mine")
    with refused(OutputError, world.out / "eval/08/scores.txt"):
        evaluate_scans(scans[:1], world.out, SPACE, part=part)


def test_labels_of_another_data_set_get_a_hint(tmp_path):
    world = World(tmp_path)
    world.add("000000", [24] * 50, [ROAD] * 50)
    with pytest.raises(NoInputError) as caught:
        world.evaluate()
    assert "with label_space" in caught.value.hint
