# SPDX-License-Identifier: MIT
"""Files that released versions wrote are read."""

import json
import shutil

import pytest
from command_line import called
from compatible import DATA, OUT, SCANS, WEIGHTS, few_channels, predict

from salsanext_cli import read_labels

VERSIONS = sorted(path.name for path in DATA.iterdir())


@pytest.fixture(params=VERSIONS)
def folder(request, tmp_path):
    """Return a copy of the files of a version."""
    return shutil.copytree(DATA / request.param, tmp_path / "copy")


def test_weights_are_described_and_give_the_labels_that_they_gave(folder, tmp_path):
    with few_channels():
        predict(folder, tmp_path / "new")
    name = "sequences/08/predictions/000000.label"
    labels, expected = (read_labels(path / name) for path in (tmp_path / "new", folder / OUT))
    assert (labels == expected).mean() > 0.99  # Processors round differently.
    with few_channels():
        result = called("models", folder / WEIGHTS, "--json")
    (weights,) = json.loads(result.stdout)["weights"]
    assert weights["description"] == "random"


def test_output_folders_are_evaluated(folder):
    file = folder / OUT / "eval.json"
    before = json.loads(file.read_text("utf-8"))
    for path in (file, file.with_name("scores.txt")):
        path.unlink()  # Times of a checkout are not those of the record.
    called("eval", folder / OUT, "--dataset", folder / SCANS)
    after = json.loads(file.read_text("utf-8"))
    assert after["scores"] == before["scores"]
    assert after["confusion"] == before["confusion"]


def test_output_folders_are_exported_and_reported(folder):
    data = ("--dataset", folder / SCANS)
    called("export-ply", folder / OUT, *data, "--colour", "truth")
    called("report", folder / OUT, *data)
    assert (folder / OUT / "sequences/08/ply/truth/000000.ply").is_file()
    assert (folder / OUT / "report.html").is_file()
