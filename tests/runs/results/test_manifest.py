# SPDX-License-Identifier: MIT
"""Records of the runs of a stage."""

import json
from pathlib import Path

import pytest
from recorded_runs import KNN, SETTINGS, TYPED, predict, scans_of
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.provenance import Provenance


def test_an_infinite_setting_is_recorded_as_text(tmp_path: Path) -> None:
    for _ in range(2):
        predict(tmp_path, {"knn": KNN | {"cutoff": float("inf")}})
    text = (tmp_path / "predict.json").read_text()
    settings = json.loads(text, parse_constant=pytest.fail)["settings"]
    assert settings == {"knn": KNN | {"cutoff": "Infinity"}}
    assert Manifest(tmp_path).settings("predict").knn.cutoff == float("inf")


@pytest.mark.parametrize(
    "content",
    [
        *("{", "{}", '{"stage": "predict"}', '{"stage": "predict", "settings": {}, "writes": 3}'),
        '{"stage": "predict", "settings": {}, "writes": ["elsewhere"]}',
        '{"stage": "project", "settings": {}, "writes": []}',
        '{"stage": "predict", "settings": {}, "scans": {"08": {"folder": 3, "asked_for": []}}}',
    ],
)
def test_damaged_records_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "predict.json").write_text(content)
    for read in (predict, lambda folder: Manifest(folder).owner("predictions")):
        refused(OutputError, tmp_path / "predict.json", read, tmp_path)


def test_records_of_older_versions_are_read(tmp_path: Path) -> None:
    """Settings may be null or in another order, and two keys had other names."""
    risk = {"kind": "error", "threshold": 0.2, "at_most": 0.05, "confidence": None, "scans": 20}
    older = {"knn": KNN, "labels": None, "weights": "abc"}
    content = {"stage": "predict", "version": "0.1", "settings": older, "writes": ["predictions"]}
    more = {"settings": {"promised": risk | {"sequences": ["00"]}}, "kept": ["a.label"]}
    (tmp_path / "predict.json").write_text(json.dumps(content | more))
    assert Manifest(tmp_path).settings("predict").guarantee.threshold == 0.2
    assert Manifest(tmp_path).record("predict").foreign == ("a.label",)
    (tmp_path / "predict.json").write_text(json.dumps(content))
    origins = Provenance(tmp_path).origins(["predict"])
    predict(tmp_path)
    assert Provenance(tmp_path).origins(["predict"]) == origins
    assert Manifest(tmp_path).settings("predict") == TYPED


def test_recorded_scales_without_extent_are_ignored(tmp_path: Path) -> None:
    """Older versions recorded one of a value that did not vary, such as no intensity."""
    scales = {"intensity": [0, 0], "height": [-2, 3]}
    content = {"stage": "picture", "settings": {"scales": scales}}
    (tmp_path / "picture.json").write_text(json.dumps(content))
    assert Manifest(tmp_path).settings("picture").scales == {"height": (-2, 3)}
    record = Manifest(tmp_path).record("picture")
    assert record.has_settings({"scales": scales | {"intensity": [0.1, 0.9]}})
    assert not record.has_settings({"scales": scales | {"height": [0, 1]}})
    for scale in ([], [0], 0, "00"):
        content["settings"]["scales"] = {"intensity": scale}
        (tmp_path / "picture.json").write_text(json.dumps(content))
        refused(OutputError, tmp_path / "picture.json", Manifest(tmp_path).settings, "picture")


def test_digests_of_training_scans_come_last(tmp_path: Path) -> None:
    digest = "0" * 24
    predict(tmp_path, SETTINGS | {"trained_on": digest}, scans=scans_of(tmp_path, "a"))
    content = json.loads((tmp_path / "predict.json").read_text())
    assert [*content] == ["stage", "version", "writes", "settings", "scans"]
    assert [*content["settings"]][-1] == "trained_on"
    assert Provenance(tmp_path).trained_on().digests == {digest}
