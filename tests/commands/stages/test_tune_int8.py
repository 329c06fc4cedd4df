# SPDX-License-Identifier: MIT
"""Stage `tune int8`, and predictions in int8."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from safetensors.torch import load_file
from scans import refused, write_weights
from shallow_network import shallow  # noqa: F401
from tiny_network import TinyNetwork

from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.tune import tune_int8
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.engines.device import number_type_of_labels
from salsanext_cli.core.errors import FormatError, OutputError, WeightsError
from salsanext_cli.core.network.card import FittedParts, RiskThreshold
from salsanext_cli.core.network.registry import ARCHITECTURES
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.runs.fit import sensor_fit
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.training.tuning.int8 import int8_layers


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what is compiled in one folder for all tests, which compile the same networks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def network(on_openvino, tmp_path):
    """Return settings of a network of two levels on OpenVINO, whatever the folder has."""
    file = write_weights(tmp_path / "shallow.safetensors")
    return replace(on_openvino.network, weights=file)


def test_ranges_are_added_and_nothing_else_changes(world, network, target):
    labels = world.data / "sequences/08/labels"
    for file in labels.iterdir():
        file.unlink()
    report = tune_int8(world.data, target, settings=network)
    before, after = map(read_card, (network.path, target))
    assert before.int8 == {}
    assert replace(after, int8={}).to_metadata() == before.to_metadata()
    tensors = load_file(network.path)
    assert all(np.array_equal(tensor, tensors[name]) for name, tensor in load_file(target).items())
    layers = int8_layers(network.load().module)
    assert after.int8.keys() == layers.keys()
    assert (report.scans, report.layers) == (3, len(layers))
    refused(OutputError, target, tune_int8, world.data, target, settings=network)


@pytest.mark.parametrize("precision", ["int8", "int8 with bfloat16 and tiles of bytes", "float32"])
def test_a_threshold_chosen_with_other_ranges_is_removed(world, network, target, precision):
    settings = {"--precision": precision}
    risk = RiskThreshold("error", 0.2, 0.1, None, 20, ("00",), settings=settings)
    known = target.with_name("risk.safetensors")
    card = read_card(network.path)
    narrow = {16: FittedParts(risk=risk)}
    card = replace(card, risk=risk, widths=(card.sensor.width, 16), parts_of_widths=narrow)
    save_with_card(network.path, known, card)
    tune_int8(world.data, target, settings=replace(network, weights=known))
    tuned = read_card(target)
    expected = risk if precision == "float32" else None
    assert (tuned.risk, tuned.parts_of_widths[16].risk) == (expected, expected)


def test_steps_in_one_or_apart_agree_in_int8_and_differ_from_float32(world, network, target):
    tune_int8(world.data, target, settings=network)
    int8 = replace(network, weights=target, precision="int8", fit=False)
    predicted = predict_scans(world.data, world.out, settings=int8, extras=("pixel_labels",))
    assert predicted.has_int8_ranges
    assert Manifest(world.out).settings("predict").precision == number_type_of_labels("int8")
    seen = int8.load().sensor
    steps = world.out.with_name("steps")
    project_scans(world.data, steps, sensor=seen)
    assert predict_range_images(steps, steps, settings=int8).has_int8_ranges
    float32 = replace(int8, precision="float32")
    predict_scans(world.data, world.out.with_name("f"), settings=float32, extras=("pixel_labels",))
    name = "sequences/08/pixel_labels/000000.npy"
    pixels = [np.load(folder / name) for folder in (world.out, steps, world.out.with_name("f"))]
    assert np.array_equal(pixels[0], pixels[1])
    assert 0.5 < (pixels[0] == pixels[2]).mean() < 1


def test_a_cpu_that_computes_int8_in_another_way_does_not_continue_a_run(
    world, network, target, monkeypatch
):
    tune_int8(world.data, target, settings=network)
    int8 = replace(network, weights=target, precision="int8", fit=False)
    monkeypatch.setattr(sensor_fit, "number_type_of_labels", lambda name: f"{name} with AMX")
    predict_scans(world.data, world.out, settings=int8)
    assert predict_scans(world.data, world.out, settings=int8).done == 0
    monkeypatch.undo()
    record = Manifest(world.out).path("predict")
    caught = refused(OutputError, record, predict_scans, world.data, world.out, settings=int8)
    assert "int8 was computed with AMX" in caught.value.problem


def test_sampling_is_in_float32_and_needs_no_ranges(world, network):
    int8 = replace(network, precision="int8")
    uncertainty(world.data, world.out, settings=int8, method=UncertaintyMethod(2, 0, "none"))
    assert Manifest(world.out).settings("uncertainty").precision == "float32"


def test_a_network_without_hidden_layers_is_refused(world, network, target, monkeypatch):
    monkeypatch.setitem(ARCHITECTURES, "salsanext", TinyNetwork)
    file = write_weights(target.with_name("tiny.safetensors"))
    settings = replace(network, weights=file)
    refused(WeightsError, file, tune_int8, world.data, target, settings=settings)
    assert not target.exists()


def test_what_cannot_be_fitted_is_refused(world, network, target):
    assert not predict_scans(world.data, world.out, settings=network).has_int8_ranges
    with refused(WeightsError, network.path):
        replace(network, precision="int8").load()
    for scan in world.data.glob("sequences/*/velodyne/*"):
        scan.write_bytes(b"")
    refused(FormatError, world.scan(), tune_int8, world.scan(), target, settings=network)
    assert not target.exists()
