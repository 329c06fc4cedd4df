# SPDX-License-Identifier: MIT
"""Copies to and from a device have the values of what is copied."""

import numpy as np
import torch
from devices import on_each_device

from salsanext_cli.core.engines.device_copies import (
    HostCopies,
    device_numbers,
    pinned,
    pinned_array,
)


@on_each_device
def test_numbers_are_rounded_to_the_type(device):
    values = [[0.1, 1 / 3], [2.0**24 + 1, -1e-40]]
    found = device_numbers(values, device)
    assert (found.device.type, found.dtype) == (device, torch.float32)
    np.testing.assert_array_equal(found.cpu().numpy(), np.float32(values))
    assert device_numbers([True, False], device, torch.bool).tolist() == [True, False]
    assert device_numbers([2**40 + 1], device, torch.int64).tolist() == [2**40 + 1]


@on_each_device
def test_copies_are_contiguous_and_of_the_values_at_their_call(device):
    """A change after the call is not seen on a GPU; on the CPU they are the tensors."""
    values = torch.arange(24, device=device).view(2, 3, 4).permute(2, 0, 1)
    copies = HostCopies.of([values, values.half()])
    expected = np.arange(24).reshape(2, 3, 4).transpose(2, 0, 1)
    if device != "cpu":
        values.add_(1)
    for array, number_type in zip(copies.arrays(), (np.int64, np.float16), strict=True):
        assert array.dtype == number_type
        assert array.flags.c_contiguous
        np.testing.assert_array_equal(array, expected)


@on_each_device
def test_memory_is_pinned_for_a_gpu(device):
    assert pinned(torch.ones(2), device).is_pinned() == (device != "cpu")
    values = np.arange(12, dtype=np.float32).reshape(4, 3)[:, ::2]
    found = pinned_array(values, device)
    assert found.is_pinned() == (device != "cpu")
    np.testing.assert_array_equal(found.numpy(), values)
