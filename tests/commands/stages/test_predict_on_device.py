# SPDX-License-Identifier: MIT
"""`predict`, `label` and `label_drive` on the way of a GPU, which runs on the CPU too."""

from dataclasses import replace

import numpy as np
import pytest
from devices import on_each_device
from scans import files_below, share_alike

import salsanext_cli as sn
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core import labellers
from salsanext_cli.core.on_device.labeller import DeviceLabeller

MOST_CHANGED = 1e-5  # Share of points whose label may differ from that of the kernels
EXTRAS = ("pixel_labels", "probabilities", "objects", "votes")


@pytest.fixture
def on_device(monkeypatch):
    """Return a function after which torch labels points on its device, also on the CPU."""

    def choose() -> None:
        monkeypatch.setattr(labellers, "computes_on_gpu", lambda n: n.backend.library == "torch")

    return choose


def assert_same_results(folder, expected):
    found = files_below(folder)
    others = files_below(expected)
    assert found.keys() == others.keys()
    assert share_alike(folder, expected) >= 1 - MOST_CHANGED
    arrays = [name for name in found if name.endswith(".npy")]
    assert arrays
    for name in arrays:
        values, other = np.load(folder / name), np.load(expected / name)
        assert values.dtype == other.dtype
        # Votes are integers: a probability may be rounded to the next.
        tolerance = 1 if "votes" in name else 2e-3
        np.testing.assert_allclose(
            values.astype(float), other.astype(float), atol=tolerance, err_msg=name
        )


@on_each_device
@pytest.mark.parametrize("batch", [1, 2])
def test_results_are_those_of_the_kernels(world, tmp_path, on_device, device, batch):
    kernels = replace(world.network, device="cpu", precision="float32")
    predict_scans(world.data, tmp_path / "kernels", settings=kernels, extras=EXTRAS)
    on_device()
    settings = replace(kernels, device=device)
    outcome = predict_scans(
        world.data, tmp_path / "device", settings=settings, extras=EXTRAS, batch=batch
    )
    assert outcome.done == 3
    assert_same_results(tmp_path / "device/sequences", tmp_path / "kernels/sequences")


def test_the_labels_have_the_bytes_of_the_kernels(world, tmp_path, on_device):
    predict_scans(world.data, tmp_path / "kernels", settings=world.network)
    on_device()
    predict_scans(world.data, tmp_path / "device", settings=world.network)
    assert share_alike(tmp_path / "device", tmp_path / "kernels") == 1


def test_a_scan_in_memory(world, on_device):
    network = world.network.load()
    scan = sn.read_scan(world.scan())
    expected = sn.label(scan.points, scan.intensity, network)
    on_device()
    assert isinstance(labellers.labeller_for(network, labellers.LabelRequest()), DeviceLabeller)
    found = sn.label(scan.points, scan.intensity, network)
    np.testing.assert_array_equal(found.labels, expected.labels)
    np.testing.assert_allclose(found.probabilities, expected.probabilities, atol=1e-5)
    assert found.error is None
