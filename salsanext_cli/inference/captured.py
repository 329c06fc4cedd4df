# SPDX-License-Identifier: MIT
"""A network on a GPU as one recorded sequence of kernels, played again for every batch.

A light network is many short kernels: starting them one by one takes the CPU longer than they run.
"""

from __future__ import annotations

from threading import Lock

import torch
from torch import Tensor

from salsanext_cli.network.segmentation import SegmentationNetwork

RECORDING = Lock()
"""A process may record one sequence at a time."""
WARM_UP = 3
"""Runs before recording, in which libraries choose their algorithms and allocate."""


class Captured:
    """Calls a network, on a GPU by way of a CUDA graph per size of batch.

    Parameters
    ----------
    engine : SegmentationNetwork
        In evaluation mode; its weights are not changed any more.
    """

    def __init__(self, engine: SegmentationNetwork) -> None:
        self.engine = engine
        self.recorded: dict[torch.Size, tuple[torch.cuda.CUDAGraph, Tensor, Tensor]] = {}

    def __call__(self, images: Tensor) -> Tensor:
        """Map (B, 5, H, W) to logits (B, C, H, W), which the next call overwrites."""
        if images.device.type != "cuda":
            logits: Tensor = self.engine(images)
            return logits
        if images.shape not in self.recorded:
            self.recorded[images.shape] = self._record(images)
        graph, inputs, outputs = self.recorded[images.shape]
        inputs.copy_(images)
        graph.replay()
        return outputs

    def forget(self) -> None:
        """Free the memory of all recordings."""
        self.recorded.clear()
        torch.cuda.empty_cache()

    def _record(self, images: Tensor) -> tuple[torch.cuda.CUDAGraph, Tensor, Tensor]:
        device = images.device
        inputs = images.clone(memory_format=torch.channels_last)
        aside = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                self.engine(inputs)
        torch.cuda.current_stream(device).wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        # Others may pin memory meanwhile, in other threads.
        with RECORDING, torch.cuda.graph(graph, stream=aside, capture_error_mode="thread_local"):
            outputs = self.engine(inputs)
        return graph, inputs, outputs
