# SPDX-License-Identifier: MIT
"""Tests that run on the CPU and, where there is one, on a GPU."""

import pytest
import torch

CUDA = [pytest.mark.cuda, pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")]


def on_both(*of_cuda: str) -> pytest.MarkDecorator:
    """Run a test on the CPU in float32, and on a GPU in each of some precisions."""
    both = [pytest.param("cuda", precision, marks=CUDA) for precision in of_cuda]
    return pytest.mark.parametrize(("device", "precision"), [("cpu", "float32"), *both])
