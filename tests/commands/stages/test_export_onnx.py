# SPDX-License-Identifier: MIT
"""Weights as ONNX models."""

import sys
from dataclasses import replace

import pytest
from narrow_network import NARROW
from other_program import require_kept
from scans import SMALL, lively, refused, write_weights
from shallow_network import shallow  # noqa: F401

from salsanext_cli import label_space
from salsanext_cli.commands.stages import export_onnx as stage
from salsanext_cli.commands.stages.export_onnx import export_onnx
from salsanext_cli.core.errors import MissingDependency, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.io.weights import onnx_export
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.onnx_export import largest_difference, onnx_model, run
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.runs.network_settings import NetworkSettings

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

ODD = replace(SMALL, name="odd", height=19, width=70)
"""Neither divided by 16."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_weights(tmp_path_factory.mktemp("shallow") / "random.safetensors")


@pytest.mark.parametrize(("sensor", "channels"), [(SMALL, NARROW), (ODD, {})])
def test_the_model_computes_the_logits_of_torch(sensor, channels):
    module, card = lively(SalsaNext(**channels)), WeightsCard({}, label_space(), sensor)
    model = onnx_model(module, card)
    onnx.checker.check_model(model, full_check=True)
    assert largest_difference(model.SerializeToString(), module, card) < 1e-4


def test_a_dynamic_width():
    module = lively(SalsaNext(**NARROW))
    card = WeightsCard({}, label_space(), replace(SMALL, height=19))
    content = onnx_model(module, card, dynamic_width=True).SerializeToString()
    for width in (16, 128, 304):
        other = replace(card, sensor=replace(card.sensor, width=width))
        assert largest_difference(content, module, other) < 1e-4


def test_opset_names_shapes_and_the_whole_card(tmp_path, weights):
    """A model is no weights file."""
    path = tmp_path / "model.onnx"
    report = export_onnx(weights, path)
    refused(WeightsError, path, NetworkSettings(path).load)
    assert report.to_dict()["input"] == [1, 5, 16, 128]
    assert report.size == path.stat().st_size
    assert report.difference < 1e-4
    model = onnx.load(path)
    assert [entry.version for entry in model.opset_import] == [17]
    (image,), (logits,) = model.graph.input, model.graph.output
    assert (image.name, logits.name) == ("image", "logits")
    assert [d.dim_value for d in image.type.tensor_type.shape.dim] == [1, 5, 16, 128]
    assert {p.key: p.value for p in model.metadata_props} == read_card(weights).to_metadata()
    # All sizes are constants, and nothing describes this machine.
    assert not {node.op_type for node in model.graph.node} & {"Shape", "Pad", "Loop", "If"}
    assert not [node for node in model.graph.node if node.doc_string]


def test_the_card_has_the_sensor_of_the_images_and_the_intensity_of_the_training(tmp_path, weights):
    quantiles = tuple(i / INTENSITY_LEVELS for i in range(INTENSITY_LEVELS))
    module, card = read_weights(weights)
    known = replace(card, sensor=replace(SMALL, intensity_quantiles=quantiles))
    source, target = tmp_path / "w.safetensors", tmp_path / "m.onnx"
    save_weights(source, module, known)
    report = export_onnx(source, target, sensor=SMALL.resized(16, 64), dynamic_width=True)
    assert report.to_dict()["output"] == [1, 20, 16, "any"]
    metadata = {p.key: p.value for p in onnx.load(target).metadata_props}
    expected = replace(SMALL.resized(16, 64), intensity_quantiles=quantiles)
    assert WeightsCard.from_metadata(metadata, target).sensor == expected


def test_a_wrong_model_is_refused(tmp_path, weights, monkeypatch):
    def wrong(content, image):
        return run(content, image) * 1.002

    monkeypatch.setattr(onnx_export, "run", wrong)
    refused(WeightsError, "ONNX model", export_onnx, weights, tmp_path / "m.onnx")
    assert not (tmp_path / "m.onnx").exists()


def test_a_file_that_was_written_meanwhile_is_kept(tmp_path, weights):
    target = tmp_path / "m.onnx"

    def export(overwrite):
        export_onnx(weights, target, overwrite=overwrite)

    require_kept(stage, target, export)


def test_without_onnx_runtime_the_model_is_not_compared(tmp_path, weights, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert export_onnx(weights, tmp_path / "m.onnx").difference is None
    monkeypatch.setitem(sys.modules, "onnx", None)
    refused(MissingDependency, "onnx", export_onnx, weights, tmp_path / "other.onnx")
