# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""The host hands a batch to the device without waiting for it, but where `error` needs it."""

import copy
from dataclasses import replace

import pytest
import torch
from scans import SMALL, make_scan
from shallow import shallow, weights  # noqa: F401
from torch.overrides import TorchFunctionMode
from unlike_sensors import for_unlike_sensor

from salsanext_cli import load_network
from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.core.engines.host_use import FROM_NUMBERS, HostUseRefused, depends_on_values
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.label_request import LabelRequest
from salsanext_cli.core.on_device.labeller import DeviceLabeller

SCANS = [make_scan(2000), make_scan(1500, 2)]


class WaitsRefused(HostUseRefused):
    """Context in which a call raises `RuntimeError` if the host must wait for device "meta"."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if kwargs and kwargs.get("non_blocking"):
            return func(*args, **kwargs)
        return super().__torch_function__(func, types, args, kwargs)


class HostUses(TorchFunctionMode):
    """Context that collects the names of calls that would wait, if the CPU were a GPU."""

    def __init__(self):
        self.names = []

    def __torch_function__(self, func, types, args=(), kwargs=None):
        named = kwargs or {}
        name = func.__name__
        is_copy = name in FROM_NUMBERS or (name == "to" and names_device([*args, *named.values()]))
        is_waited_for = is_copy and not named.get("non_blocking")
        if is_waited_for or depends_on_values(name, args, named):
            self.names.append(name)
        return func(*args, **named)


def names_device(values):
    return any(isinstance(value, str | torch.device) for value in values)


@pytest.fixture
def network(weights):
    return for_unlike_sensor(load_network(weights, "cpu", SMALL, "float32", "torch"))


@pytest.mark.slow
def test_labels_need_no_value_of_a_device(network, monkeypatch):
    """Device "meta" stands for the GPU: nothing can be read from it."""
    on_meta = copy.deepcopy(network.module).to("meta")
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda tensor: tensor)
    monkeypatch.setattr(TorchBackend, "torch_module", on_meta)
    monkeypatch.setattr(TorchBackend, "_call", lambda _, name, function, *inputs: function(*inputs))
    copied = []
    monkeypatch.setattr(HostCopies, "of", copied.extend)
    backend = replace(network.backend, device="meta")
    labeller = DeviceLabeller(
        network=replace(network, backend=backend), request=LabelRequest(softmax=True)
    )
    prepared = [labeller.prepare(scan) for scan in SCANS]
    with WaitsRefused():
        with pytest.raises(RuntimeError, match="between devices"):
            torch.ones(2).to("meta")
        labeller.compute(prepared)
    assert {tensor.device.type for tensor in copied} == {"meta"}
    assert sum(len(tensor) == len(SCANS[0]) + len(SCANS[1]) for tensor in copied) == 3


def host_uses(network, request):
    """Return the names of the calls that would wait for a GPU while a batch is computed."""
    labeller = DeviceLabeller(network=network, request=request)
    prepared = [labeller.prepare(scan) for scan in SCANS]
    _ = network.backend.torch_module  # Its weights are read and checked here.
    with HostUses() as uses:
        labeller.compute(prepared)
    return uses.names


def test_the_host_waits_for_no_label(network):
    assert not host_uses(network, LabelRequest(softmax=True))


def test_the_host_waits_for_few_numbers_of_the_errors(network):
    names = host_uses(network, LabelRequest(error=True))
    assert names.count("nonzero") == 1
    assert {*names} == {"nonzero", "equal"}
    assert len(names) <= 4


@pytest.mark.parametrize(
    ("waits", "name"),
    [
        (lambda x: x.sum().item(), "item"),
        (lambda x: x[x > 0], "__getitem__"),
        (lambda x: x.to("cpu"), "to"),
        (lambda x: x.new_tensor([1.0]), "new_tensor"),
        (lambda _: torch.tensor([1.0], device="cpu"), "tensor"),
    ],
)
def test_calls_that_would_wait_are_found(waits, name):
    with HostUses() as uses:
        waits(torch.ones(2))
    assert uses.names == [name]
