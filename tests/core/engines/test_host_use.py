# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Calls in which the host waits for the device are refused; those of the networks are not."""

import copy

import numpy as np
import pytest
import torch
from host_waits import META, WaitsRefused
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import load_network, project
from salsanext_cli.core.engines.host_use import HostUseRefused
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.uncertainty.aleatoric import aleatoric
from salsanext_cli.core.uncertainty.monte_carlo import sample

X = torch.tensor([[1.0, 0.0], [2.0, 3.0]])
REFUSED = r"needs the host|between devices"
ON_OTHER_DEVICE = torch.empty(2, 2, device="meta")


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
@pytest.mark.parametrize(
    "needs_host",
    [
        lambda x: x * x.sum().item(),
        lambda x: x if x.sum() > 0 else -x,
        lambda x: x.nonzero(),
        lambda x: x[x > 0],
        lambda x: x[[0, 1]],
        lambda x: x[:, np.array([0])],
        lambda x: x.clone().index_put_((x > 0,), torch.ones(3)),
        lambda x: x.masked_select(x > 0),
        lambda x: x.unique(),
        lambda x: x.clone().index_put_([x > 0], torch.ones(3)),
        lambda x: x.repeat_interleave(torch.tensor([1, 2]), dim=0),
        lambda x: torch.repeat_interleave(x[0].long()),
        lambda x: torch.where(x > 0),
        lambda x: x.equal(x),
        lambda x: 1.0 in x,
        lambda x: x.to("meta"),
        lambda x: x.new_tensor([1.0], device="meta"),
        lambda _: torch.tensor([1.0], device="meta"),
        lambda _: ON_OTHER_DEVICE.clone().copy_(X),
    ],
)
def test_the_host_is_not_needed(mode, needs_host):
    with mode():
        needs_host(X)
        with HostUseRefused(), pytest.raises(RuntimeError, match=REFUSED):
            needs_host(X)


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_other_calls_have_their_results(mode):
    rows = torch.tensor([1, 0])
    with mode(), HostUseRefused():
        result = torch.where(X > 1, X[rows], X.masked_fill(X > 2, 0.0)).softmax(dim=1)
    expected = torch.where(X > 1, X[rows], X.masked_fill(X > 2, 0.0)).softmax(dim=1)
    assert torch.equal(result, expected)


@pytest.mark.parametrize(
    "waits",
    [
        lambda there: torch.tensor([1.0], device=META),
        lambda there: there.new_tensor([1.0]),
        lambda there: torch.ones(3).to(META, non_blocking=True),
        lambda there: torch.ones(3).pin_memory().to(META),
        lambda there: there.copy_(torch.ones(3)),
        lambda there: there.__setitem__(slice(None), torch.ones(3)),
        lambda there: there[[0, 1]],
        lambda there: there[torch.tensor([0, 1])],
        lambda there: there[there > 0],
        lambda there: there.sum().item(),
        lambda there: there.to("cpu"),
        lambda there: torch.repeat_interleave(there.long()),
    ],
)
def test_what_a_gpu_waits_for_is_refused(waits):
    """Beside the calls that no graph records: copies that are not from pinned memory."""
    with WaitsRefused(), pytest.raises((RuntimeError, NotImplementedError)):
        waits(torch.ones(3, device=META))


def test_what_a_gpu_does_not_wait_for_is_permitted():
    there = torch.ones(3, device=META)
    values = torch.tensor([1.0, 2.0, 3.0])
    with WaitsRefused(pinned=[values]):
        assert values.sum().item() == 6  # The values are on the host.
        copied = values[1:].to(META, non_blocking=True)
        pinned = torch.ones(3).pin_memory().to(META, non_blocking=True)
        repeated = there.repeat_interleave(there.long(), output_size=9)
        scaled = (there + pinned)[1:] * copied * torch.tensor(2.0)
    assert repeated.shape == (9,)
    assert scaled.shape == (2,)


def test_no_recorded_call_of_a_network_needs_the_host(weights, monkeypatch):
    """Device "meta" stands for the GPU: no tensor of a call may be on the CPU."""
    network = load_network(weights, "cpu", SMALL, "float32", "torch")
    on_meta = copy.deepcopy(network.module).to("meta")
    names = set()

    def refusing(self, name, function, module, *inputs):
        names.add(name)
        copies = [tensor.to("meta") for tensor in inputs]
        with HostUseRefused():
            function(on_meta, *copies)
        return function(module, *inputs)

    monkeypatch.setattr(TorchBackend, "_call", refusing)
    image = project(make_scan(2000), SMALL)
    network.probabilities(image)
    sample(network, image, samples=2, seed=1)
    aleatoric(network, image)
    assert {"logits", "trunk", "rest"} < names
