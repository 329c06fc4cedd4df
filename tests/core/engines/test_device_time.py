# SPDX-License-Identifier: MIT
"""Times of calls on a device, by its own clock."""

import time

import pytest
import torch
from devices import on_each_device

from salsanext_cli.core.engines.device_time import DeviceTime


@on_each_device
def test_times_are_of_the_work_of_the_device(device):
    """A call of a GPU may return before its work ends."""
    matrix = torch.ones(256, 256, device=device)
    (matrix @ matrix / 256).sum().item()  # The first product on a GPU prepares its library.
    device_time = DeviceTime(device)
    start = time.perf_counter()
    for count in (1, 40):
        with device_time.measured():
            for _ in range(count):
                matrix = matrix @ matrix / 256
    one, many = device_time.seconds()
    assert 0 < one < many < time.perf_counter() - start


def test_a_call_that_fails_is_not_measured():
    device_time = DeviceTime("cpu")
    with pytest.raises(ZeroDivisionError), device_time.measured():
        _ = 1 / 0
    assert device_time.seconds() == []
