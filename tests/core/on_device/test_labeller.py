# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Labels of scans on a device are those of the kernels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from devices import on_each_device
from error_models import layers
from scans import SMALL, make_scan, refused
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Network, Scan, load_network
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.errors import FormatError, WeightsError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labellers import KernelLabeller, Labeller
from salsanext_cli.core.labelling import LabelledScan, LabelRequest
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device.labeller import DeviceLabeller
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.label_spaces import label_space

MOST_CHANGED = 1e-5  # Share of points whose label may differ from that of the kernels
ALL_RESULTS = LabelRequest(softmax=True, error=True)
MOVED = Scan(make_scan(2500, 1).points + np.float32([0, 0, 0.5]), make_scan(2500, 1).intensity)
SCANS = [make_scan(3000), MOVED, make_scan(1500, 2)]


@pytest.fixture
def network(weights, device: str) -> Network:
    """Return a network with an error model, on the device."""
    network = load_network(weights, device, SMALL, "float32", "torch")
    model = ErrorModel(features=FEATURES, layers=layers(9, 6, 1))
    backend = replace(network.backend, card=replace(network.card, error=model))
    return replace(network, backend=backend, sensor=replace(SMALL, min_range=4.5))


def labelled_by(labeller: Labeller, scans: list[Scan]) -> list[LabelledScan]:
    prepared = [labeller.prepare(scan) for scan in scans]
    computed = labeller.compute(prepared)
    return [labeller.finish(*pair) for pair in zip(prepared, computed, strict=True)]


def assert_same(found: list[LabelledScan], expected: list[LabelledScan]) -> None:
    for scan, other in zip(found, expected, strict=True):
        assert scan.labels.dtype == np.uint8
        assert (scan.labels != other.labels).mean() <= MOST_CHANGED
        assert (scan.pixel_labels != other.pixel_labels).mean() <= MOST_CHANGED
        np.testing.assert_allclose(scan.least_confidence, other.least_confidence, atol=1e-5)
        assert scan.mean_confidence == pytest.approx(other.mean_confidence, abs=1e-6)
        assert scan.checked.check == other.checked.check
        assert (scan.softmax is None) == (other.softmax is None)
        assert (scan.error is None) == (other.error is None)
        if other.softmax is not None:
            assert scan.softmax.dtype == other.softmax.dtype
            tolerance = 1e-5 if scan.softmax.dtype == np.float32 else 1e-3
            np.testing.assert_allclose(scan.softmax, other.softmax, atol=tolerance)
        if other.error is not None:
            np.testing.assert_allclose(scan.error, other.error, atol=1e-4)


def both(network: Network, request: LabelRequest, file: Path) -> tuple[Labeller, Labeller]:
    """Return labellers of a network and of the same on the CPU, from its file of weights."""
    backend = load_network(file, "cpu", SMALL, "float32", "torch").backend
    of_cpu = replace(network, backend=replace(backend, card=network.card))
    kernels = KernelLabeller(network=of_cpu, request=request)
    return DeviceLabeller(network=network, request=request), kernels


@on_each_device
@pytest.mark.parametrize(
    "request_", [LabelRequest(), ALL_RESULTS, LabelRequest(knn=KnnParameters(window=1, k=1))]
)
def test_results_are_those_of_the_kernels(network, weights, request_):
    on_device, kernels = both(network, request_, weights)
    found = labelled_by(on_device, SCANS)
    assert found[0].checked.check.ego_points > 0
    assert_same(found, labelled_by(kernels, SCANS))


@on_each_device
def test_errors_are_final_after_any_number_of_rounds(network, weights):
    """Regions that need more rounds than a batch has are joined again."""
    on_device, kernels = both(network, ALL_RESULTS, weights)
    prepared = on_device.prepare(SCANS[0])
    (computed,) = on_device.compute([prepared], rounds=1)
    assert not computed.results()["is_final"]
    assert_same([on_device.finish(prepared, computed)], labelled_by(kernels, SCANS[:1]))


@on_each_device
def test_scans_of_several_sensors_and_merged_classes(network, weights):
    first = replace(SMALL, traits=(900.0, 900.0, 500.0, 300.0, 3000.0, 1.0))
    other = replace(
        SMALL, origin=(0.0, 0.0, 0.5), fov_up=5.0, traits=(9.0, 9.0, 9.0, 9.0, 90.0, 1.0)
    )
    merging = ClassMerging.between(network.space, label_space("coarse"))
    network = replace(network, sensor=replace(first, others=(other,)), merging=merging)
    on_device, kernels = both(network, LabelRequest(softmax=True, half_softmax=True), weights)
    assert_same(labelled_by(on_device, SCANS), labelled_by(kernels, SCANS))


@on_each_device
def test_a_batch_has_the_labels_of_single_scans(network, weights):
    labeller, _ = both(network, ALL_RESULTS, weights)
    alone = [labelled_by(labeller, [scan])[0] for scan in SCANS]
    assert_same(labelled_by(labeller, SCANS), alone)


@on_each_device
def test_a_kept_result_keeps_no_memory_of_its_batch(network, weights):
    labeller, _ = both(network, ALL_RESULTS, weights)
    for scan in labelled_by(labeller, SCANS):
        arrays = [scan.labels, scan.least_confidence, scan.pixel_labels, scan.softmax, scan.error]
        assert all(array.flags.owndata for array in arrays)


@on_each_device
def test_the_range_image_is_that_of_the_kernels(network, weights):
    on_device, kernels = both(network, LabelRequest(), weights)
    (found,) = labelled_by(on_device, SCANS[:1])
    (expected,) = labelled_by(kernels, SCANS[:1])
    image = found.checked.range_image()
    np.testing.assert_array_equal(image.channels, expected.checked.range_image().channels)


@on_each_device
def test_errors_name_the_source(network, weights):
    labeller, _ = both(network, LabelRequest(), weights)
    kilometres = Scan(make_scan().points / 1000, make_scan().intensity)
    refused(FormatError, "far.bin", labeller.prepare, kilometres, source="far.bin")
    broken = replace(network.card, temperature=float("nan"))
    backend = replace(network.backend, card=broken)
    labeller = DeviceLabeller(network=replace(network, backend=backend), request=LabelRequest())
    scan = labeller.prepare(make_scan(), source="a.bin")
    (computed,) = labeller.compute([scan])
    with pytest.raises(WeightsError, match=r"a\.bin"):
        labeller.finish(scan, computed)
