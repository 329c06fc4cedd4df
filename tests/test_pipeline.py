# SPDX-License-Identifier: MIT
"""The package as shipped: default weights, the three command lines, real scans."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
import safetensors
import torch
from command_line import called
from devices import on_each_device
from scans import labels_below, share_alike, write_bin, write_sequence

from benchmarks.weights.background_training import CHANGES
from salsanext_cli import (
    knn_refine,
    label_space,
    load_network,
    project,
    read_labels,
    read_scan,
    sensor,
)
from salsanext_cli.commands.stages.import_weights import import_weights
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.synth import synthesise
from salsanext_cli.core import labellers
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.uncertainty.error_features import error_probability, knows_error
from salsanext_cli.io.weights.card_file import default_weights
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.training.recipe import Recipe, recipe
from salsanext_cli.training.tuning.error import error_scores

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
        called(*line.split()[1:])
    assert Path("out/scores.txt").read_text().startswith("accuracy_mean: ")
    (cloud,) = Path("out/sequences/seq/ply").iterdir()
    vertex = plyfile.PlyData.read(cloud)["vertex"]
    names = {p.name for p in vertex.properties}
    kinds = ("label", "truth", "wrong", "least_confidence")
    assert {f"scalar_{kind}" for kind in kinds} <= names
    assert np.isfinite(vertex["scalar_least_confidence"]).all()
    assert len(np.unique(vertex["green"])) > 20


@pytest.mark.slow
@pytest.mark.real
def test_real_scans_in_steps_or_in_one(golden, real_data, tmp_path):
    """Published weights on real scans, at a quarter of the width.

    `test_in_three_steps_or_in_one_gives_the_same_bytes` has random weights and small scans.
    """
    import_weights(golden / "SalsaNext", tmp_path / "w.safetensors", half=True)
    small = sensor("hdl64-512")
    network = NetworkSettings(tmp_path / "w.safetensors", "cpu", sensor=small)
    data, selection = real_data / "data/semantickitti", ScanSelection(split="valid", limit=2)
    project_scans(data, tmp_path / "steps", sensor=small, selection=selection)
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


def test_the_default_weights_are_small_and_describe_themselves():
    assert default_weights().stat().st_size < 15e6
    with safetensors.safe_open(default_weights(), framework="pt") as file:
        assert file.get_tensor("logits.weight").dtype == torch.float16
    card = load_network(None, "cpu").card
    assert "Hesai and Scale AI, CC BY 4.0" in card.description
    assert "not for use on real roads" in card.description
    # The initial weights of a training are not part of a recipe.
    plan = recipe("street").with_changes(**CHANGES, precision="bfloat16")
    assert Recipe.from_dict({**card.recipe, "initial": "random"}) == plan


@pytest.mark.parametrize("scenes", [2, pytest.param(16, marks=pytest.mark.slow)])
def test_the_default_weights_label_unseen_scenes(tmp_path, scenes):
    """On average: a single scene may be ranked worse by error than by confidence."""
    synthesise(tmp_path, train=0, valid=scenes, scans=1, seed=1234)
    network = load_network(None, "cpu")
    assert knows_error(network)
    columns = [[], [], []]
    for file in find_scans(tmp_path):
        scan = read_scan(file.path)
        image = project(scan, network.sensor)
        probabilities = network.probabilities(image)
        labels = knn_refine(image, probabilities.argmax(axis=0))
        truth = network.card.space.to_train(read_labels(file.label_path, len(scan)))
        confidence = points_from_pixels(probabilities, image.pixel_of_point, np.eye(1, 20))
        doubt = 1 - confidence[np.arange(len(labels)), labels]
        error = error_probability(network, image, probabilities, labels)
        for all_points, values in zip(columns, (labels != truth, error, doubt), strict=True):
            all_points.append(values[truth > 0])
    wrong, error, doubt = map(np.concatenate, columns)
    assert wrong.mean() < 0.25
    error, baseline = (error_scores(values, wrong) for values in (error, np.clip(doubt, 0, 1)))
    assert error.aurc < baseline.aurc
    assert error.ece < 0.06


@pytest.mark.real
@pytest.mark.parametrize("classes", [None, "coarse"])
def test_noise_is_a_warning(real_data, tmp_path, classes):
    scan = read_scan(real_data / "data/semantickitti/sequences/00/velodyne/000000.bin")
    noise = np.random.default_rng(0).normal(0, 1, scan.points.shape).astype(np.float32)
    write_bin(tmp_path / "scans/street.bin", scan)
    write_bin(tmp_path / "scans/noisy.bin", replace(scan, points=scan.points + noise))
    settings = NetworkSettings(classes=label_space(classes) if classes else None)
    outcome = predict_scans(tmp_path / "scans", tmp_path / "out", settings=settings)
    doubted = {warning.code: warning.scans for warning in outcome.summary.warnings()}
    assert doubted == {code: ["scans/noisy"] for code in ("low-confidence", "noisy")}


@pytest.mark.real
def test_a_hall_has_labels_of_low_confidence(real_data, tmp_path):
    (scan,) = (real_data / "data/reported/indoor/pandar64_hall").iterdir()
    outcome = predict_scans(scan, tmp_path / "out")
    assert "low-confidence" in {warning.code for warning in outcome.summary.warnings()}


@pytest.mark.real
@on_each_device
@pytest.mark.parametrize("width", [512, 1024])
@pytest.mark.slow
def test_real_scans_are_labelled_on_a_device_as_by_the_kernels(
    real_data, tmp_path, monkeypatch, device, width
):
    """At most one label in 100 000 may differ; errors have other orders of sums.

    `tests/core/on_device` compares results of small scans, and pixels of real ones.
    """
    source = real_data / "data/semantickitti/sequences/08"
    settings = NetworkSettings(device="cpu", engine="torch", precision="float32", width=width)
    few = {"extras": ("uncertainty/error",), "selection": ScanSelection(limit=2)}
    predict_scans(source, tmp_path / "kernels", settings=settings, **few)
    monkeypatch.setattr(labellers, "computes_on_gpu", lambda _: True)
    settings = replace(settings, device=device)
    predict_scans(source, tmp_path / "device", settings=settings, **few)
    assert share_alike(tmp_path / "device", tmp_path / "kernels") >= 1 - 1e-5
    errors = sorted((tmp_path / "kernels").rglob("error/*.npy"))
    assert errors
    for path in errors:
        found = np.load(tmp_path / "device" / path.relative_to(tmp_path / "kernels"))
        differences = np.abs(found - np.load(path))
        assert np.nanquantile(differences, 0.999) < 1e-4
        assert (np.isnan(found) == np.isnan(np.load(path))).all()
