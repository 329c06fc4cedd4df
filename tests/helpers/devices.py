# SPDX-License-Identifier: MIT
"""Tests that run on the CPU and, where there is one, on a GPU."""

from collections.abc import Iterator
from contextlib import contextmanager

import numba
import pytest
import torch

CUDA = [pytest.mark.cuda, pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")]

on_each_device = pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=CUDA)])
"""Run a test on the CPU and, where there is one, on a GPU."""


def on_both(*of_cuda: str) -> pytest.MarkDecorator:
    """Run a test on the CPU in float32, and on a GPU in each of some precisions."""
    both = [pytest.param("cuda", precision, marks=CUDA) for precision in of_cuda]
    return pytest.mark.parametrize(("device", "precision"), [("cpu", "float32"), *both])


@contextmanager
def waits_refused() -> Iterator[None]:
    """Let calls fail for which the host would wait for a GPU."""
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Set the number of threads of torch and of kernels."""
    settings, of_torch = vars(numba.config), torch.get_num_threads()
    of_kernels = settings["NUMBA_NUM_THREADS"]
    torch.set_num_threads(count)
    settings["NUMBA_NUM_THREADS"] = count
    try:
        yield
    finally:
        torch.set_num_threads(of_torch)
        settings["NUMBA_NUM_THREADS"] = of_kernels
