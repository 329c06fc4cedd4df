# SPDX-License-Identifier: MIT
"""Models in int8: what stays float32, and the same results by two runtimes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import python
from scans import SMALL, make_scan, write_bin, write_sequence, write_weights

from salsanext_cli import Scan, load_network, project, read_scan
from salsanext_cli.engines.onnx_export import run
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NoInputError, UsageError
from salsanext_cli.fitting.sensor_fit import ScanSample, fit_scans
from salsanext_cli.network.card import read_card
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.results.paths import find_scans
from salsanext_cli.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.stages import export_onnx as stage
from salsanext_cli.stages.export_onnx import export_onnx

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("nncf")


pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("00"), ["0", "1", "2", "3"], labels=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory, weights, scans):
    """Return a model in int8 and what the stage says of it."""
    path = tmp_path_factory.mktemp("int8") / "int8.onnx"
    return path, export_onnx(weights, path, calibrate=scans)


def test_most_labels_are_those_of_float32(made, weights):
    path, said = made
    assert said["scans"] == 4
    assert said["bytes"] == path.stat().st_size < weights.stat().st_size / 3
    image = project(make_scan(seed=2), SMALL)
    full, short = (load_network(p, "cpu").probabilities(image) for p in (weights, path))
    occupied = image.channels[0] > 0
    equal = (full.argmax(0) == short.argmax(0))[occupied].mean()
    assert 0.9 < equal < 1
    assert abs(equal - said["equal_labels"]) < 0.03


def test_openvino_computes_what_onnx_runtime_does(made):
    """Not so with signed feature maps, which lose half of the labels."""
    network = load_network(made[0], precision="float32")
    image = project(make_scan(), SMALL)
    (expected,) = run(made[0].read_bytes(), [network.input(image.channels)])
    found = network.logits(image)
    assert np.abs(found - expected[0]).mean() < 0.03 * np.abs(expected).mean()


def test_context_and_logits_stay_float32(made):
    model = onnx.load(made[0])
    onnx.checker.check_model(model, full_check=True)
    types = {tensor.name: tensor.data_type for tensor in model.graph.initializer}
    full = [n.name for n in model.graph.node if n.op_type == "Conv" and n.input[1] in types]
    assert {name.split("/")[1] for name in full} == {"context", "logits"}
    zeros = [n.input[2] for n in model.graph.node if n.op_type == "QuantizeLinear"]
    assert {types[name] for name in zeros} == {onnx.TensorProto.UINT8}


def test_it_sees_what_predict_sees(tmp_path, monkeypatch):
    """Scans of another scale of intensity, upside down."""
    known = replace(SMALL, intensity_quantiles=tuple(np.linspace(0, 1, INTENSITY_LEVELS) ** 2))
    weights, seen = write_weights(tmp_path / "known.safetensors", sensor=known), []
    scans = tmp_path / "scans"
    for name in ("0", "1"):
        scan = make_scan(9000, int(name))
        turned = Scan(scan.points * np.float32([1, -1, -1]), scan.intensity * 255)
        write_bin(scans / f"{name}.bin", turned)

    def calibrated(model, scans, image_of):
        seen.extend(image_of(scan) for scan in scans)
        return model

    monkeypatch.setattr(stage, "quantised", calibrated)
    said = export_onnx(weights, tmp_path / "m.onnx", calibrate=scans)
    settings, files = NetworkSettings(weights, fit=True, intensity="auto"), find_scans(scans)
    network = settings.load()
    network = fit_scans(settings, network, ScanSample(files, network.sensor))
    assert network.sensor.up != SMALL.up
    for file, image in zip(files, seen, strict=True):
        upright = project(read_scan(file.path), network.sensor).channels
        np.testing.assert_array_equal(image, network.input(upright))
    assert max(image[0, 4].max() for image in seen) == pytest.approx((1 - 0.21) / 0.16, abs=0.01)
    assert said["equal_labels"] == 1
    view = SMALL.resized(16, 64)
    export_onnx(weights, tmp_path / "other.onnx", view=view, calibrate=scans)
    assert read_card(tmp_path / "other.onnx").sensor == replace(
        view, intensity_quantiles=known.intensity_quantiles
    )


def test_too_few_scans(tmp_path, weights, scans):
    for selection in (ScanSelection(limit=1), ScanSelection(sequences=("none",))):
        with pytest.raises((UsageError, NoInputError)) as caught:
            export_onnx(weights, tmp_path / "m.onnx", calibrate=scans, selection=selection)
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("*.onnx"))


def test_the_command_prints_json_only_and_opens_no_socket(tmp_path, weights, scans):
    """A test's process would not do: NNCF does not report its use from one."""
    target = tmp_path / "m.onnx"
    line = ["export-onnx", weights, target, "--int8", "--calibrate", scans, "--limit", 2, "--json"]
    code = f"""
import socket, sys
class Refused(Exception): pass
def refuse(*_, **__):
    sys.stderr.write("a socket")
    raise Refused
socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
sys.argv[1:] = {[str(word) for word in line]!r}
from salsanext_cli.cli.app import main
try:
    main()
finally:
    assert not [name for name in sys.modules if name.startswith("openvino_telemetry.")]
"""
    done = python(code)
    assert done.returncode == 0, done.stderr
    assert "a socket" not in done.stderr
    assert json.loads(done.stdout)["scans"] == 2
    assert "of the labels of 2 scans" in done.stderr
