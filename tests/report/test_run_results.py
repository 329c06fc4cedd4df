# SPDX-License-Identifier: MIT
import math
from pathlib import Path

import numpy as np
import pytest
from evaluated import small_space
from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.errors import FormatError, UsageError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.geometry.objects import BOX
from salsanext_cli.network.card import default_weights, read_card
from salsanext_cli.report.page.run_results import (
    ScanRow,
    facts_of_run,
    leading_kind,
    named,
    read_boxes,
    warnings_of_run,
    worth_looking_at,
)
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import StageRecord

SPACE = small_space("unlabeled", "car", "road")


def row(stem, confusion=None, sequence="00", **uncertainty):
    file = ScanFile(sequence, stem, Path(f"/{stem}.bin"))
    matrix = None if confusion is None else np.array(confusion)
    return ScanRow(file, 10, np.array([0, 5, 5]), uncertainty, matrix)


def test_the_share_of_wrong_points_leaves_out_what_is_not_judged():
    assert row("a", [[0, 0, 0], [1, 3, 0], [0, 2, 4]]).wrong == pytest.approx(3 / 10)
    assert math.isnan(row("a").wrong)
    assert math.isnan(row("a", np.zeros((3, 3), int)).wrong)


def test_most_uncertain_most_wrong_and_worst_class_are_chosen():
    rows = [
        row("0", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.1),
        row("1", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.9),
        row("2", [[0, 0, 0], [0, 0, 0], [0, 0, 10]], entropy=math.nan),
        row("3", [[0, 0, 0], [0, 1, 4], [0, 0, 95]], entropy=0.2),
        row("4", [[0, 0, 0], [0, 5, 0], [0, 3, 2]], entropy=0.2),
    ]
    found = worth_looking_at(rows, SPACE)
    assert found["00/1"] == "most uncertain (mean entropy 0.9)"
    assert found["00/4"] == "most wrong (30.0 % of the points)"
    assert found["00/3"] == "worst class: 4 points of car wrong"
    assert sorted(found.values())[0] == "at random"
    assert len(found) == 4
    assert found == worth_looking_at(rows, SPACE)


def test_the_error_leads_before_the_entropy():
    rows = [row("1", entropy=1.0), row("2", error=0.5)]
    assert leading_kind(rows) == "error"
    assert leading_kind(rows[:1]) == "entropy"
    assert leading_kind([row("3")]) is None


def test_scans_are_named_by_sequence_and_stem_or_by_the_stem_alone():
    rows = [row("1", sequence="00"), row("1", sequence="08"), row("2", sequence="08")]
    assert named(rows, ["2", "00/1"]) == {"08/2": "named", "00/1": "named"}
    for name, says in (("1", "2 scans"), ("08/9", "no results of a scan of that name")):
        with pytest.raises(UsageError, match=says):
            named(rows, [name])


def record(out, stage, folders, **settings):
    shared = {"label_space": label_space().to_dict(), "sensor": SMALL.to_dict()}
    StageRecord(stage, shared | settings, folders).write(out)


def test_the_default_weights_are_described(tmp_path):
    record(
        *(tmp_path, "predict", ("predictions",)),
        **{"weights": fingerprint(default_weights()), "engine": "openvino"},
        **{"precision": "bfloat16", "temperature": 1.25, "reject": 0.3},
    )
    facts = dict(facts_of_run(tmp_path, SMALL))
    start = read_card(default_weights()).description.replace("`", "").partition(" See ")[0]
    assert start in facts["Weights"]
    # The page may be mailed: it says itself what the page on the weights would.
    assert "docs/" not in facts["Weights"]
    assert "Not for use on real roads. On real scans they " in facts["Weights"]
    assert facts["Sensor"].startswith("small, 16×128, view +3° to -25°")
    assert "openvino in bfloat16, temperature 1.25" in facts["Labels"]
    assert facts["Labels"].endswith("error is above 0.3")
    assert "Uncertainty" not in facts


def test_other_weights_are_named_by_their_digest_if_it_is_recorded(tmp_path):
    assert dict(facts_of_run(tmp_path, SMALL))["Weights"] == "not recorded"
    record(
        *(tmp_path, "uncertainty", ("uncertainty/epistemic",)),
        **{"weights": "ab" * 32, "method": "sampling", "samples": 30, "aleatoric": "copies"},
    )
    facts = dict(facts_of_run(tmp_path, SMALL))
    assert facts["Weights"].startswith("SHA-256 abababababab, not the default ones")
    assert facts["Uncertainty"] == "sampling, samples 30, aleatoric copies"


def test_findings_of_all_stages_are_one_line_for_each_kind(tmp_path):
    dark, few = ("dark", "no intensity", "look"), ("few-points", "12 points", "drive on")
    found = {f"00/{i}": [dark] for i in range(5)}
    OwnedFolder(tmp_path, "predict").keep_findings(found, set(found))
    OwnedFolder(tmp_path, "uncertainty").keep_findings({"00/1": [dark, few]}, {"00/1"})
    assert warnings_of_run(tmp_path, found) == [
        "dark in 5 scans (00/0, 00/1, 00/2 and 2 more): no intensity; look",
        "few-points in 1 scan (00/1): 12 points; drive on",
    ]
    (only,) = warnings_of_run(tmp_path, {"00/3"})
    assert only == "dark in 1 scan (00/3): no intensity; look"
    assert warnings_of_run(tmp_path / "none", found) == []
    OwnedFolder(tmp_path, "fuse").keep_findings({"00": [("apart", "two parts", "look")]}, {"00"})
    assert warnings_of_run(tmp_path, {"00"}) == ["apart in 1 sequence (00): two parts; look"]


def test_boxes_are_those_of_the_table_or_it_is_refused(tmp_path):
    path, space = tmp_path / "000000.csv", label_space()
    assert read_boxes(path, space) == []
    head = f"object,class,points,{','.join(BOX)}\n"
    path.write_text(f"{head}1,car,12,1,2,3,4,2,1.5,-0.5\n2,merged,9,0,0,0,1,1,1,0\n")
    car = space.names.index("car")
    assert read_boxes(path, space) == [[car, 1, 2, 3, 4, 2, 1.5, -0.5], [0, 0, 0, 0, 1, 1, 1, 0]]
    for damaged in ("1,car,12,1,2,3,4,2,1.5,nan", "1,car,12,1,2", "1,car,12,1,2,3,4,2,1.5,wide"):
        path.write_text(head + damaged)
        with pytest.raises(FormatError, match=r"000000.csv · .* expected a table of `predict"):
            read_boxes(path, space)
