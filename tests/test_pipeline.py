# SPDX-License-Identifier: MIT
"""The pipeline as a user types it, and each of its ways the same bytes."""

from pathlib import Path

import numpy as np
import plyfile
import pytest
from scans import labels_below, write_sequence
from typer.testing import CliRunner

from salsanext_cli import label_space, sensor
from salsanext_cli.cli.app import app
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.options import ScanSelection
from salsanext_cli.stages.import_weights import import_weights
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans

THREE_LINES = (
    "salsanext predict seq/velodyne out/",
    "salsanext eval --split valid",
    "salsanext export-ply --colour uncertainty",
)


@pytest.mark.usefixtures("narrow_default")
def test_the_three_lines_as_typed(tmp_path, monkeypatch):
    """In the root of a data set, where `seq` is one of its sequences."""
    folder = tmp_path / "Semantic KITTI"
    write_sequence(folder / "sequences/08", ["000000"])
    (folder / "seq").symlink_to("sequences/08")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("SALSANEXT_ENGINE", "torch")
    for line in THREE_LINES:
        done = CliRunner().invoke(app, line.split()[1:])
        assert done.exit_code == 0, done.stderr
    assert Path("out/scores.txt").read_text().startswith("accuracy_mean: ")
    (cloud,) = Path("out/sequences/seq/ply").iterdir()
    vertex = plyfile.PlyData.read(cloud)["vertex"]
    names = {p.name for p in vertex.properties}
    kinds = ("label", "truth", "wrong", "least_confidence")
    assert {f"scalar_{kind}" for kind in kinds} <= names
    assert np.isfinite(vertex["scalar_least_confidence"]).all()
    assert len(np.unique(vertex["green"])) > 20


@pytest.mark.real
def test_real_scans_in_steps_or_in_one(golden, real_data, tmp_path):
    """Published weights on real scans, a quarter of the width to save time."""
    import_weights(golden / "SalsaNext", tmp_path / "w.safetensors", half=True)
    view = sensor("hdl64-512")
    network = NetworkSettings(tmp_path / "w.safetensors", "cpu", sensor=view)
    data, selection = real_data / "data/semantickitti", ScanSelection(split="valid", limit=2)
    project_scans(data, tmp_path / "steps", sensor=view, selection=selection)
    predict_range_images(tmp_path / "steps", tmp_path / "steps", settings=network)
    knn_refine_scans(tmp_path / "steps")
    predict_scans(data, tmp_path / "fused", settings=network, selection=selection)
    labels = labels_below(tmp_path / "fused")
    assert labels_below(tmp_path / "steps") == labels
    assert list(labels) == [f"sequences/08/predictions/00000{n}.label" for n in (0, 1)]
    for content in labels.values():
        ids = set(np.frombuffer(content, "<u4"))
        assert ids <= set(label_space().learning_map_inv.values())
        assert len(ids) > 3
