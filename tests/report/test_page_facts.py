# SPDX-License-Identifier: MIT
import os

from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.network.card import default_weights, read_card
from salsanext_cli.report.page.facts import facts_of_run, warnings_of_run
from salsanext_cli.results.layout import output_path
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import StageRecord

SPACE = label_space().to_dict()


def record(out, stage, folders, **settings):
    shared = {"label_space": SPACE, "sensor": SMALL.to_dict()}
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


def test_the_time_per_scan_is_that_between_results(tmp_path):
    record(tmp_path, "predict", ("predictions",))
    begin = 1_700_000_000.0
    for number, time in enumerate((0, 0.1, 0.3, 4000, 4000.1, 4000.4)):
        path = output_path(tmp_path, "00", "predictions", f"{number:06}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"result")
        os.utime(path, (begin + time, begin + time))
        OwnedFolder(tmp_path).add(path)
    assert dict(facts_of_run(tmp_path, SMALL))["Time"] == "predict: 0.18 s per scan"
    path.write_bytes(b"another")
    assert "Time" not in dict(facts_of_run(tmp_path, SMALL))


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
