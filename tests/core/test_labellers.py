# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The way of one scan in memory, by the kernels and on a device."""

import ast
import inspect
from dataclasses import fields, replace

import numpy as np
import pytest
from scans import SMALL, make_scan, refused
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import KnnParameters, Scan, knn_refine, load_network, project
from salsanext_cli.core import labellers
from salsanext_cli.core.engines.backend import PixelPrediction, device_backend
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.errors import FormatError, WeightsError
from salsanext_cli.core.labellers import KernelLabeller, label_scan, labeller_for
from salsanext_cli.core.labelling import LabelRequest
from salsanext_cli.core.on_device.labeller import DeviceLabeller

LONGEST = 15  # Statements and lines of a table of contents


@pytest.fixture(scope="module")
def network(weights):
    return load_network(weights, "cpu", SMALL, engine="torch")


def test_it_reads_like_a_table_of_contents():
    (function,) = [
        node
        for node in ast.parse(inspect.getsource(labellers)).body
        if isinstance(node, ast.FunctionDef) and node.name == "label_scan"
    ]
    body = function.body[1:]
    assert body[-1].end_lineno - body[0].lineno < LONGEST


@pytest.mark.parametrize("softmax", [False, True])
def test_labels_are_those_of_the_single_steps(network, softmax):
    scan = make_scan()
    labelled = label_scan(scan, network, LabelRequest(softmax=softmax))
    image = project(scan, SMALL)
    probabilities = network.probabilities(image)
    expected = knn_refine(image, probabilities.argmax(axis=0), network.space.class_count)
    np.testing.assert_array_equal(labelled.labels, expected)
    assert labelled.checked.check.points == len(scan)
    occupied = image.channels[0] > 0
    mean = probabilities.max(axis=0)[occupied].mean()
    assert labelled.mean_confidence == pytest.approx(mean, abs=1e-6)
    assert (labelled.softmax is None) == (not softmax)


def test_the_parameters_of_knn_are_used(network):
    scan = make_scan()
    narrow = KnnParameters(window=1, k=1)
    alone = label_scan(scan, network, LabelRequest(knn=narrow))
    image = alone.checked.range_image()
    expected = knn_refine(image, alone.pixel_labels, network.space.class_count, narrow)
    np.testing.assert_array_equal(alone.labels, expected)
    assert (alone.labels != label_scan(scan, network).labels).any()


def test_a_registered_scan_is_projected_from_its_origin(network):
    scan = make_scan()
    registered = replace(SMALL, registered=True)
    moved = Scan(scan.points + np.float32([5, 0, 0]), scan.intensity)
    labelled = label_scan(moved, network.for_sensor(registered), origin=(5.0, 0.0, 0.0))
    assert labelled.checked.sensor.origin == labelled.checked.origin == (5.0, 0.0, 0.0)


def test_errors_name_the_source(network):
    kilometres = Scan(make_scan().points / 1000, make_scan().intensity)
    refused(FormatError, "far.bin", label_scan, kilometres, network, source="far.bin")


def test_probabilities_that_are_not_finite_are_refused(network, monkeypatch):
    nowhere = np.full((SMALL.height, SMALL.width), np.nan, np.float32)
    broken = PixelPrediction(np.zeros_like(nowhere, np.uint8), nowhere)
    monkeypatch.setattr(labellers, "predict_pixels", lambda *_, **__: [broken])
    with pytest.raises(WeightsError, match=r"a\.bin"):
        label_scan(make_scan(), network, source="a.bin")


def test_a_network_on_a_gpu_labels_the_points_there(network, monkeypatch):
    """Torch on a CPU leaves them to the kernels."""
    monkeypatch.setattr("salsanext_cli.core.engines.torch_backend.set_up_cuda", lambda: None)
    request = LabelRequest()
    assert isinstance(labeller_for(network, request), KernelLabeller)
    on_gpu = replace(network, backend=replace(network.backend, device="cuda"))
    assert isinstance(labeller_for(on_gpu, request), DeviceLabeller)


class OtherLibrary(TorchBackend):
    """Another library that computes from tensors."""

    library = "other"


def test_any_library_with_tensors_on_a_gpu_labels_the_points_there(network, monkeypatch):
    monkeypatch.setattr("salsanext_cli.core.engines.torch_backend.set_up_cuda", lambda: None)
    scan = make_scan()
    expected = label_scan(scan, network)
    torch_backend = network.backend
    values = {field.name: getattr(torch_backend, field.name) for field in fields(torch_backend)}
    on_gpu = replace(network, backend=OtherLibrary(**{**values, "device": "cuda"}))
    assert isinstance(labeller_for(on_gpu, LabelRequest()), DeviceLabeller)
    on_cpu = DeviceLabeller(
        network=replace(network, backend=OtherLibrary(**values)), request=LabelRequest()
    )
    prepared = on_cpu.prepare(scan)
    (computed,) = on_cpu.compute([prepared])
    np.testing.assert_array_equal(on_cpu.finish(prepared, computed).labels, expected.labels)


def test_a_library_without_tensors_cannot_label_on_a_device(weights):
    kernels = load_network(weights, "cpu", SMALL, engine="openvino")
    with pytest.raises(TypeError, match="openvino"):
        device_backend(kernels.backend)
