# SPDX-License-Identifier: MIT
import io
import json
import shutil

import numpy as np
import pytest
from evaluated import CAR, ROAD, SPACE, World
from rich.console import Console
from scans import files_below, refused

from salsanext_cli import label_space, read_scan, sensor
from salsanext_cli.errors import NoInputError, OutputError, UsageError
from salsanext_cli.network.card import scan_digest
from salsanext_cli.report.comparison import comparison_tables
from salsanext_cli.results.paths import find_scans, output_path
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.stages.compare import compare
from salsanext_cli.stages.evaluate import evaluate

TREE = 70


@pytest.fixture
def runs(tmp_path):
    """Return two runs on six scans with truth and one without; the second run is better."""
    worlds = World(tmp_path), World(tmp_path)
    worlds[1].out = tmp_path / "after"
    for number in range(6):
        truth = [CAR, ROAD, ROAD, TREE, 0] * 4
        before = np.where(np.arange(20) < 2 + number, CAR, truth)
        worlds[0].add(f"{number}", truth, before, distance=5 + 10 * (number % 2))
        worlds[1].add(f"{number}", truth, truth, distance=5 + 10 * (number % 2))
    for world in worlds:
        world.add("9", None, [CAR] * 3)
    return worlds


def compared(runs, classes=None):
    query = ResultQuery(runs[0].dataset, classes=classes)
    result, failures = compare(runs[0].out, runs[1].out, query=query)
    return result, failures, json.loads((runs[1].out / "compare.json").read_text())


def recorded(world, space=SPACE, **settings):
    """Write a record of `predict`."""
    settings |= {"label_space": space.to_dict(), "sensor": sensor("hdl64").to_dict()}
    record = {"stage": "predict", "settings": settings, "writes": ["predictions"], "scans": {}}
    (world.out / "predict.json").write_text(json.dumps(record))


def test_scores_are_those_of_eval(runs):
    result, failures, data = compared(runs)
    assert failures == ()
    before, after = (evaluate(find_scans(w.dataset)[:6], w.out, SPACE).scores for w in runs)
    accuracy = result.scores["accuracy"]
    assert (accuracy.before, accuracy.after) == (before.accuracy, after.accuracy)
    mean = result.scores["mean IoU, 3 classes"]
    assert (mean.before, mean.after) == (before.iou_mean_present, after.iou_mean_present)
    assert 0 < accuracy.low <= accuracy.difference <= accuracy.high
    assert result.scores["car"].before == before.classes[0].iou
    assert (data["scans"], data["scored"], data["trained_on"]) == (7, 6, [])
    assert data["changed_most"][0]["scan"] == "08/5"


def test_a_record_is_replaced_unless_it_was_changed(runs):
    compared(runs)
    first = files_below(runs[1].out)
    compared(runs)
    assert files_below(runs[1].out).keys() == first.keys()
    (runs[1].out / "compare.json").write_text("{}")
    with refused(OutputError, runs[1].out / "compare.json"):
        compared(runs)


def test_training_scans_of_either_run_are_not_scored(runs):
    files = find_scans(runs[0].dataset)
    for world, file in zip(runs, files, strict=False):
        recorded(world, trained_on=scan_digest(read_scan(file.path)))
    # Scans of equal points are one scan.
    _, _, data = compared(runs)
    assert data["trained_on"] == [f"08/{i}" for i in range(6)]
    assert (data["scored"], data["scores"]) == (0, {})
    assert data["agreement"] < 1


def test_equal_runs_have_no_empty_tables(runs):
    shutil.rmtree(runs[1].out)
    shutil.copytree(runs[0].out, runs[1].out)
    console = Console(record=True, file=io.StringIO())
    console.print(comparison_tables(compared(runs)[0]))
    text = console.export_text()
    assert "scans: all are the same" in text
    assert "Scans that changed most" not in text
    assert "share %" not in text


def test_scans_that_cannot_be_compared_are_counted(runs, tmp_path, caplog):
    output_path(runs[1].out, "08", "predictions", "0").unlink()
    runs[1].add("1", None, [CAR] * 3)
    _, failures, data = compared(runs)
    assert "1 scan skipped" in caplog.text
    assert data["alone"] == 1
    assert "1.label: has 3 labels" in failures[0].reason
    with pytest.raises(NoInputError):
        compare(runs[0].out, tmp_path / "nowhere", query=ResultQuery(runs[0].dataset))
    shutil.rmtree(runs[1].out / "sequences")
    runs[1].add("8", None, [CAR])
    with refused(NoInputError, runs[1].out):
        compared(runs)


def test_runs_in_other_classes_are_compared_in_merged_classes(runs):
    recorded(runs[0])
    recorded(runs[1], space=label_space("coarse"))
    with refused(UsageError, runs[1].out):
        compared(runs)
    result, _, _ = compared(runs, classes=label_space("coarse"))
    assert result.scores["vehicle"].after == 1


def test_other_scans_of_the_same_names_are_refused(runs, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(runs[0].dataset, moved)
    query = ResultQuery(runs[0].dataset)
    for world, dataset in zip(runs, (runs[0].dataset, moved), strict=True):
        recorded(world)
        record = json.loads((world.out / "predict.json").read_text())
        stems = [f"{number}" for number in (*range(6), 9)]
        folder = str(dataset / "sequences/08/velodyne")
        record["scans"] = {"08": {"folder": folder, "asked_for": stems}}
        (world.out / "predict.json").write_text(json.dumps(record))
    assert len(compare(runs[0].out, runs[1].out)[0].pairs) == 7
    first = moved / "sequences/08/velodyne/0.bin"
    first.write_bytes(np.flip(np.fromfile(first, np.float32)).tobytes())
    with refused(UsageError, first):
        compare(runs[0].out, runs[1].out)
    assert len(compare(runs[0].out, runs[1].out, query=query)[0].pairs) == 7
    with refused(UsageError, "OUT_B"):
        compare(runs[0].out, runs[0].out)
