# SPDX-License-Identifier: MIT
"""Calls on a GPU that are recorded as CUDA graphs, so that a small one is a single launch.

A network launches hundreds of kernels. For few pixels, launching them takes longer than computing.
A graph costs the memory of a call, and copies of its inputs and outputs. So it is kept only if
replaying it is measurably faster on this GPU.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from salsanext_cli.core.engines.host_use import HostUseRefused
from salsanext_cli.core.engines.memory import out_of_memory

MAX_GRAPHS = 8  # Graphs of a network: each keeps the memory of a call
TIMED_CALLS = 3  # Of which the fastest counts
MOST_OF_PLAIN = 0.9  # Largest share of the time of a plain call that a graph may take
WARM_UP_CALLS = 3  # Calls before the recording, in which libraries allocate what they need
Function = Callable[..., tuple[Tensor, ...]]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCall:
    """Call that reads and writes the same memory each time."""

    graph: torch.cuda.CUDAGraph
    inputs: list[Tensor]
    outputs: tuple[Tensor, ...]

    def replayed(self, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Return copies of the outputs for other inputs of the same shapes."""
        for recorded, current in zip(self.inputs, inputs, strict=True):
            recorded.copy_(current)
        self.graph.replay()
        return tuple(output.clone() for output in self.outputs)


class CudaGraphs:
    """Functions of tensors on a GPU, recorded once for each name and shape of their inputs."""

    def __init__(self) -> None:
        self._calls: dict[Any, RecordedCall | None] = {}
        self._lock = threading.Lock()

    def call(self, name: str, function: Function, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return ``function(*inputs)``, replayed if that is possible and faster.

        Parameters
        ----------
        name : str
            Identifies the function.
        function : callable
            Function of tensors to a tuple of tensors.
        *inputs : Tensor
            Arguments on a GPU.

        Returns
        -------
        tuple of Tensor
        """
        key = (name, *((tensor.shape, tensor.dtype) for tensor in inputs))
        with self._lock:
            if key not in self._calls and len(self._calls) < MAX_GRAPHS:
                self._calls[key] = faster_call(function, inputs)
            call = self._calls.get(key)
            if call is not None:
                return call.replayed(inputs)
        return function(*inputs)


def faster_call(function: Function, inputs: tuple[Tensor, ...]) -> RecordedCall | None:
    """Record a call; return None if it cannot be recorded, or is about as fast without.

    Nor is it kept if memory runs out while it is compared: without it, the call may fit.
    """
    call = recorded_call(function, inputs)
    if call is None:
        return None
    device = inputs[0].device
    try:
        plain = least_seconds(partial(function, *inputs), device)
        replayed = least_seconds(partial(call.replayed, inputs), device)
    except RuntimeError as error:
        if not out_of_memory(error):
            raise
        log.debug("not replayed as a CUDA graph: %s", error)
        return None
    if replayed < MOST_OF_PLAIN * plain:
        return call
    text = "not replayed as a CUDA graph, which takes %.2f ms instead of %.2f ms"
    log.debug(text, 1e3 * replayed, 1e3 * plain)
    return None


def least_seconds(call: Callable[[], object], device: torch.device) -> float:
    """Return the least time of some calls in seconds, each until the device has ended its work."""
    seconds = []
    for _ in range(TIMED_CALLS):
        torch.cuda.synchronize(device)
        start = time.perf_counter()
        call()
        torch.cuda.synchronize(device)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def recorded_call(function: Function, inputs: tuple[Tensor, ...]) -> RecordedCall | None:
    """Record a call; return None if memory runs out, or if the function needs the host.

    Parameters
    ----------
    function : callable
        Function of tensors to a tuple of tensors.
    inputs : tuple of Tensor
        Arguments on a GPU, which are copied.

    Returns
    -------
    RecordedCall or None
    """
    device = inputs[0].device
    try:
        with torch.cuda.device(device):
            own_inputs = [tensor.clone() for tensor in inputs]
            # The stream is of this device: that of `torch.cuda.graph` is of the first one used.
            stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            stream.wait_stream(torch.cuda.current_stream())
            # `torch.cuda.graph` does not restore the stream after an error: this context does.
            with torch.cuda.stream(stream):
                for _ in range(WARM_UP_CALLS):
                    function(*own_inputs)
                # A recording that fails can damage the allocator of torch 2.11 and older.
                with HostUseRefused():
                    function(*own_inputs)
                graph = torch.cuda.CUDAGraph()
                # Other threads copy scans to pinned memory meanwhile.
                mode = "thread_local"
                with torch.cuda.graph(graph, stream=stream, capture_error_mode=mode):
                    outputs = function(*own_inputs)
            torch.cuda.current_stream().wait_stream(stream)
    except RuntimeError as error:
        log.debug("not recorded as a CUDA graph: %s", error)
        return None
    return RecordedCall(graph=graph, inputs=own_inputs, outputs=outputs)
