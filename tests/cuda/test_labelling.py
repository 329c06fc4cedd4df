# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""A GPU has the next batch before the results of the last are back, and waits for no host."""

from dataclasses import replace

import numpy as np
import pytest
from devices import CUDA, on_both, waits_refused
from error_models import layers
from scans import SMALL, make_scan, write_sequence
from shallow_network import shallow, weights  # noqa: F401
from unlike_sensors import for_unlike_sensor

from salsanext_cli import Network, load_network
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.labelling import LabelRequest
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device.labeller import DeviceLabeller
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

BATCHES = [[make_scan(3000, 0), make_scan(500, 1)], [make_scan(2000, 2)], [make_scan(4000, 3)]]


def with_error_model(network: Network) -> Network:
    model = ErrorModel(features=FEATURES, layers=layers(9, 6, 1))
    card = replace(network.card, error=model)
    return replace(network, backend=replace(network.backend, card=card))


@on_both("float32")
@pytest.mark.parametrize("error", [False, True])
def test_batches_in_flight_have_the_labels_of_single_ones(weights, device, precision, error):
    network = with_error_model(load_network(weights, device, SMALL, precision, "torch"))
    labeller = DeviceLabeller(network=network, request=LabelRequest(softmax=True, error=error))
    batches = [[labeller.prepare(scan) for scan in scans] for scans in BATCHES]
    in_flight = [labeller.compute(scans) for scans in batches]
    for scans, computed in zip(batches, in_flight, strict=True):
        for scan, pending in zip(scans, computed, strict=True):
            found = labeller.finish(scan, pending)
            expected = labeller.finish(scan, labeller.compute([scan])[0])
            assert (found.labels == expected.labels).mean() > 0.999
            np.testing.assert_allclose(found.softmax, expected.softmax, atol=1e-5)
            if error:
                np.testing.assert_allclose(found.error, expected.error, atol=1e-3)


@pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)])
@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
def test_a_batch_waits_for_nothing(weights, device):
    """On the CPU `core/on_device/test_waits.py` says the same."""
    network = for_unlike_sensor(load_network(weights, device, SMALL, "float16", "torch"))
    labeller = DeviceLabeller(network=network, request=LabelRequest(softmax=True))
    scans = [labeller.prepare(scan) for scan in BATCHES[0]]
    first = labeller.compute(scans)  # Graphs are recorded, and constants copied
    with waits_refused():
        second = labeller.compute(scans)
    for scan, one, other in zip(scans, first, second, strict=True):
        one_labels = labeller.finish(scan, one).labels
        np.testing.assert_array_equal(one_labels, labeller.finish(scan, other).labels)


@pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)])
def test_a_folder_in_batches_has_the_labels_of_single_scans(tmp_path, weights, device):
    folder = write_sequence(tmp_path / "sequences/00", map(str, range(7)), count=900)
    settings = NetworkSettings(weights, device, sensor=SMALL, engine="torch")
    labels = []
    for batch in (1, 3):
        out = tmp_path / str(batch)
        options = RunOptions(jobs=1)
        assert predict_scans(folder, out, settings=settings, batch=batch, options=options).done == 7
        files = sorted(out.rglob("*.label"))
        labels.append(np.concatenate([np.fromfile(file, np.uint32) for file in files]))
    assert (labels[0] == labels[1]).mean() > 0.999
