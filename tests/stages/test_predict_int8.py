# SPDX-License-Identifier: MIT
"""Predictions in int8."""

from dataclasses import replace

import numpy as np
import pytest
from scans import refused, write_weights
from shallow import shallow  # noqa: F401

from salsanext_cli import project, read_scan
from salsanext_cli.errors import WeightsError
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.training.tuning.int8 import int8_inputs, int8_layers
from salsanext_cli.uncertainty.method import UncertaintyMethod

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture
def network(on_openvino, tmp_path):
    """Return settings of a network of two levels on OpenVINO, whatever the folder has."""
    file = write_weights(tmp_path / "shallow.safetensors")
    return replace(on_openvino.network, weights=file)


def test_steps_in_one_or_apart_agree_in_int8_and_differ_from_float32(world, network, target):
    loaded = replace(network, precision="float32").load()
    image = project(read_scan(world.scan()), loaded.sensor)
    ranges = int8_inputs(loaded.module, [loaded.input(image.channels)])
    assert ranges.keys() == int8_layers(loaded.module).keys()
    save_with_card(network.path, target, replace(loaded.card, int8=ranges))
    int8 = replace(network, weights=target, precision="int8", fit=False)
    predict_scans(world.data, world.out, settings=int8, extras=("pixel_labels",))
    seen = int8.load().sensor
    steps = world.out.with_name("steps")
    project_scans(world.data, steps, sensor=seen)
    predict_range_images(steps, steps, settings=int8)
    float32 = replace(int8, precision="float32")
    predict_scans(world.data, world.out.with_name("f"), settings=float32, extras=("pixel_labels",))
    name = "sequences/08/pixel_labels/000000.npy"
    pixels = [np.load(folder / name) for folder in (world.out, steps, world.out.with_name("f"))]
    assert np.array_equal(pixels[0], pixels[1])
    assert 0.5 < (pixels[0] == pixels[2]).mean() < 1


def test_sampling_is_in_float32_and_needs_no_ranges(world, network):
    int8 = replace(network, precision="int8")
    uncertainty(world.data, world.out, settings=int8, method=UncertaintyMethod(2, 0, "none"))
    assert Manifest(world.out).settings("uncertainty").precision == "float32"


def test_weights_without_ranges_are_refused(network):
    with refused(WeightsError, network.path):
        replace(network, precision="int8").load()
