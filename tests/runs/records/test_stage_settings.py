# SPDX-License-Identifier: MIT
"""Settings of the stages in their records: what is refused, and the order of the keys."""

import json
from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.plain_data import plain
from salsanext_cli.runs.records.stage_settings import settings_type
from salsanext_cli.runs.results.manifest import RESULT_STAGES, Manifest


@pytest.mark.parametrize(
    ("stage", "name", "values"),
    [
        ("predict", "trained_on", ("0" * 23, "x" * 24, 5, ["0" * 24])),
        ("fuse", "trained_on", ("0" * 23, 5)),
        ("export-ply-error", "scale", ([1.0], [1.0, "2"], 3, "12")),
        ("picture", "scales", ({"error": [1.0]}, {"error": 3}, [])),
        ("predict", "knn", ({"k": 0}, {"k": 1.5}, 5)),
        ("knn-refine", "knn", ({"k": 0}, 5)),
        ("project", "sensor", ({}, {"name": "a"}, 5, [])),
        ("predict", "label_space", ({}, 5, [])),
        ("predict", "guarantee", ({}, {"kind": "error"}, 5)),
        ("predict", "weights", ([],)),
        ("predict", "reject", ([],)),
        ("predict", "objects", ([],)),
        ("uncertainty", "seed", ([],)),
        ("uncertainty", "noise", ([], [0.1])),
        ("fuse", "reach", ([],)),
    ],
)
def test_invalid_settings_are_refused(tmp_path: Path, stage, name, values) -> None:
    for value in values:
        path = tmp_path / f"{stage}.json"
        content = {"stage": stage, "settings": {name: value}, "writes": ["predictions"]}
        path.write_text(json.dumps(content))
        with refused(OutputError, path):
            Manifest(tmp_path).settings(stage)


# Keys of the settings in the files of version 0.9.0, in their order; `frames` came later.
KEYS = {
    "project": "label_space sensor",
    "predict": (
        "label_space sensor weights weights_version inherited precision engine temperature knn "
        "reject reject_by accuracy guarantee objects trained_on"
    ),
    "knn-refine": "label_space sensor knn origins",
    "uncertainty": (
        "label_space sensor weights weights_version inherited precision engine knn method "
        "aleatoric samples seed noise trained_on"
    ),
    "fuse": (
        "label_space sensor weights weights_version inherited temperature reach fused_of origins "
        "trained_on"
    ),
    "picture": "label_space sensor colours scales origins",
    "export-ply": "label_space sensor colour scale origins",
    "export-las": "label_space sensor origins frames",
    "export-laz": "label_space sensor origins frames",
}


@pytest.mark.parametrize("stage", RESULT_STAGES)
def test_the_keys_of_a_record_keep_their_order(stage) -> None:
    expected = KEYS.get(stage, KEYS["export-ply"])
    assert " ".join(plain(settings_type(stage)())) == expected
