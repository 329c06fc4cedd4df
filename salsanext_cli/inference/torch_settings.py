# SPDX-License-Identifier: MIT
"""Settings of torch under which a network is computed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from salsanext_cli.inference.parallel_for import single_threaded_torch
from salsanext_cli.network.segmentation import SegmentationNetwork


@contextmanager
def computing(engine: SegmentationNetwork, device: torch.device) -> Iterator[None]:
    """Compute in the body: no gradients, the threads or the GPU as the engine needs them.

    On a GPU float32 is float32, without the ten bits that convolutions may have by default, and
    algorithms are those that give the same bits each time.

    Parameters
    ----------
    engine : SegmentationNetwork
        As `engine.engine_for` returns it.
    device : torch.device
        Where it is.
    """
    cudnn = {"enabled": True, "benchmark": False, "deterministic": True, "allow_tf32": False}
    with torch.inference_mode():
        if device.type == "cuda":
            with torch.cuda.device(device), torch.backends.cudnn.flags(**cudnn):
                yield
        elif engine.parallel_for:
            with single_threaded_torch():
                yield
        else:
            yield
