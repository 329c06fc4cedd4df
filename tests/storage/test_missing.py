# SPDX-License-Identifier: MIT
import pytest
from claiming import claim
from scans import SMALL

from salsanext_cli.errors import OutputError
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict
from salsanext_cli.stages.project import project_scans
from salsanext_cli.storage.json_files import read_json, write_json
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.storage.missing import without_predictions, without_results
from salsanext_cli.storage.selection import ScanSelection


def ask(world, stage, scans, settings=None, overwrite=False):
    """Leave in the output folder what a stage leaves there before its first scan."""
    claim(world.out, stage, settings or {}, ["predictions"], scans, overwrite=overwrite)


def names(absent):
    return [f"{scan.sequence}/{scan.stem}" for scan in absent.missing], absent.unasked


def test_where_nobody_recorded_anything_all_are_missed(world):
    scans = find_scans(world.data)
    world.predict_by_hand()
    assert names(without_predictions(world.out, scans)) == (
        ["00/000000", "08/000000", "08/000001"],
        0,
    )


def test_scans_that_nobody_asked_for_are_not_missed(world):
    scans = find_scans(world.data)
    ask(world, "predict", scans[1:2])
    assert names(without_predictions(world.out, scans[1:])) == (["08/000000"], 1)
    assert names(without_results(world.out, scans[1:])) == (["08/000000"], 1)
    ask(world, "predict", scans[2:])
    assert names(without_predictions(world.out, scans[1:])) == (["08/000000", "08/000001"], 0)


def test_only_the_stage_that_predicts_can_lack_predictions(world):
    scans = find_scans(world.data, ["08"])
    ask(world, "predict", scans[:1])
    claim(world.out, "uncertainty", {}, ["uncertainty/epistemic"], scans, overwrite=False)
    assert names(without_predictions(world.out, scans)) == (["08/000000"], 1)
    assert names(without_results(world.out, scans)) == (["08/000000", "08/000001"], 0)


def test_what_was_asked_for_before_results_were_replaced_is_forgotten(world):
    scans = find_scans(world.data, ["08"])
    ask(world, "predict", scans)
    ask(world, "predict", scans[:1], {"weights": "new"}, overwrite=True)
    assert names(without_predictions(world.out, scans)) == (["08/000000"], 1)


def test_refined_labels_are_those_that_predict_was_asked_for(world):
    project_scans(world.data, world.out, sensor=SMALL, selection=ScanSelection(sequences=("08",)))
    predict(world.out, world.out, network=world.network, selection=ScanSelection(limit=1))
    assert knn_refine_scans(world.out).done == 1
    scans = find_scans(world.data, ["08"])
    assert names(without_predictions(world.out, scans)) == (["08/000000"], 1)


def test_a_scan_that_failed_is_missed(world):
    world.scan("08", "000001").write_bytes(b"1")
    predict(world.data, world.out, network=world.network, options=RunOptions())
    scans = find_scans(world.data, ["08"])
    assert names(without_predictions(world.out, scans[1:])) == (["08/000001"], 0)


@pytest.mark.parametrize("asked", [3, {"predict": "all"}])
def test_a_damaged_record_is_named(world, asked):
    path = world.out / "sequences/08/source.json"
    write_json(path, {"scans": str(world.scan().parent), "asked_for": asked})
    with pytest.raises(OutputError, match=r"source\.json · damaged"):
        without_predictions(world.out, find_scans(world.data, ["08"]))


def test_going_on_changes_nothing_that_is_recorded(world):
    scans = find_scans(world.data, ["08"])
    ask(world, "predict", scans)
    record = read_json(world.out / "sequences/08/source.json")
    assert record["asked_for"] == {"predict": ["000000", "000001"]}
    ask(world, "predict", scans[:1])
    assert read_json(world.out / "sequences/08/source.json") == record
