# SPDX-License-Identifier: MIT
"""Weights as ONNX models, and what predicts with them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, lively, make_scan

from salsanext_cli import label_space, load_network, project
from salsanext_cli.engines import onnx_export
from salsanext_cli.engines.onnx_export import difference, exported, run
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import MissingDependency, UsageError, WeightsError
from salsanext_cli.network.card import WeightsCard, read_card
from salsanext_cli.network.registry import ARCHITECTURES, build
from salsanext_cli.network.weights import read_weights, save_with_card
from salsanext_cli.stages.export_onnx import export_onnx
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune import tune
from salsanext_cli.stages.uncertainty import uncertainty

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

ODD = replace(SMALL, name="odd", height=19, width=70)
"""Neither divided by 16."""

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def model(tmp_path_factory, weights):
    """Return the ONNX model of the random network."""
    path = tmp_path_factory.mktemp("onnx") / "model.onnx"
    export_onnx(weights, path)
    return path


def image(sensor=SMALL):
    return project(make_scan(), sensor)


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n == "salsanext" else pytest.mark.slow) for n in ARCHITECTURES],
)
def test_every_architecture_computes_what_torch_does(name):
    module = lively(build({"name": name, "class_count": 20, "dropout": 0.2}))
    for sensor in (SMALL, ODD):
        card = WeightsCard({"name": name, "class_count": 20}, label_space(), sensor)
        found = exported(module, card)
        onnx.checker.check_model(found, full_check=True)
        assert difference(found.SerializeToString(), module, card) < 1e-4


def test_a_dynamic_width(weights):
    module, card = read_weights(weights)
    card = replace(card, sensor=replace(SMALL, height=19))
    content = exported(module, card, dynamic_width=True).SerializeToString()
    for width in (16, 128, 304):
        other = replace(card, sensor=replace(card.sensor, width=width))
        assert difference(content, module, other) < 1e-4


def test_opset_names_shapes_and_the_whole_card(model, weights):
    found = onnx.load(model)
    assert [entry.version for entry in found.opset_import] == [17]
    (taken,), (given,) = found.graph.input, found.graph.output
    assert (taken.name, given.name) == ("image", "logits")
    assert [d.dim_value for d in taken.type.tensor_type.shape.dim] == [1, 5, 16, 128]
    assert {p.key: p.value for p in found.metadata_props} == read_card(weights).to_metadata()
    # Nothing for a runtime to find out, nothing of this machine.
    assert not {node.op_type for node in found.graph.node} & {"Shape", "Pad", "Loop", "If"}
    assert not [node for node in found.graph.node if node.doc_string]


def test_a_wrong_model_is_refused(tmp_path, weights, monkeypatch):
    def wrong(content, images):
        return [logits * 1.002 for logits in run(content, images)]

    monkeypatch.setattr(onnx_export, "run", wrong)
    with pytest.raises(WeightsError, match="differ from torch"):
        export_onnx(weights, tmp_path / "m.onnx")
    assert not (tmp_path / "m.onnx").exists()


def test_predicts_as_the_weights_do(world, model, weights):
    network, reference = (
        load_network(path, "cpu", precision="float32") for path in (model, weights)
    )
    assert np.abs(network.logits(image()) - reference.logits(image())).max() < 1e-3
    expected, found = reference.probabilities(image()), network.probabilities(image())
    assert found.dtype == np.float32
    assert np.abs(found - expected).max() < 1e-4
    # From the cache, by a process that has read nothing else.
    assert np.array_equal(load_network(model).probabilities(image()), found)
    settings = NetworkSettings(model)
    assert predict_scans(world.data, world.out, settings=settings).done == 3
    record = json.loads((world.out / "predict.json").read_text("utf-8"))
    assert record["settings"]["weights"] == network.backend.sha256


def test_another_sensor_needs_a_dynamic_width_and_a_temperature_counts(tmp_path, model, weights):
    wide, hot = replace(SMALL, width=256), tmp_path / "hot.safetensors"
    save_with_card(weights, hot, replace(read_card(weights), temperature=4.0))
    with pytest.raises(WeightsError, match="--dynamic-width"):
        load_network(model, sensor=wide)
    path = tmp_path / "dynamic.onnx"
    assert export_onnx(hot, path, dynamic_width=True)["input"] == [1, 5, 16, "any"]
    expected = load_network(hot, "cpu", wide, engine="torch").probabilities(image(wide))
    found = load_network(path, sensor=wide, precision="float32").probabilities(image(wide))
    assert np.abs(found - expected).max() < 1e-4
    with pytest.raises(WeightsError, match=r"dynamic\.onnx"):
        load_network(path, sensor=replace(SMALL, width=70))


def test_labels_and_probabilities_only(world, model, tmp_path):
    settings = NetworkSettings(model)
    with pytest.raises(WeightsError, match="labels and probabilities only"):
        uncertainty(world.data, world.out, settings=settings)
    with pytest.raises(WeightsError, match="labels and probabilities only"):
        tune("temperature", world.data, tmp_path / "t.safetensors", settings=settings)
    with pytest.raises(WeightsError, match="labels and probabilities only"):
        read_weights(model)
    for options in ({"device": "cuda"}, {"engine": "torch"}):
        with pytest.raises(UsageError, match="for an ONNX model"):
            load_network(model, **options)


def changed(model, path, change):
    found = onnx.load(model)
    change(found)
    onnx.save(found, path)
    return path


def test_models_that_are_not_ours(tmp_path, model):
    def two_outputs(found):
        found.graph.output.append(found.graph.input[0])

    def other_operation(found):
        found.graph.node[0].op_type = "Convolute"

    def huge(found):
        found.graph.initializer[0].dims[:] = [1 << 40, 1 << 40]

    def elsewhere(found):
        tensor = found.graph.initializer[0]
        tensor.ClearField("raw_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value="../../etc/passwd")

    for change in (two_outputs, other_operation, huge, elsewhere):
        path = changed(model, tmp_path / f"{change.__name__}.onnx", change)
        with pytest.raises(WeightsError, match=path.name) as caught:
            load_network(path)
        assert "\n" not in str(caught.value)
    (tmp_path / "cut.onnx").write_bytes(model.read_bytes()[:-1])
    with pytest.raises(WeightsError):
        load_network(tmp_path / "cut.onnx")


@pytest.mark.parametrize("package", ["onnx", "nncf"])
def test_missing_packages(tmp_path, world, weights, monkeypatch, package):
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(MissingDependency, match="pip install") as caught:
        export_onnx(weights, tmp_path / "m.onnx", calibrate=world.data)
    assert caught.value.subject == package
