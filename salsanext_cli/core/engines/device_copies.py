# SPDX-License-Identifier: MIT
"""Copies to and from a device that run beside other work: the host waits when it needs a result.

On the CPU they are the tensors themselves, and nothing waits.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from salsanext_cli.core.engines.memory import out_of_memory


def pinned(tensor: Tensor, device: str | torch.device) -> Tensor:
    """Return a tensor of the host in memory that a device reads directly; unchanged for a CPU."""
    if torch.device(device).type == "cpu":
        return tensor
    with memory_of_host():
        return tensor.pin_memory()


def pinned_array(values: npt.NDArray[Any], device: str | torch.device) -> Tensor:
    """Return an array as a tensor in memory that a device reads directly.

    For a GPU it is a copy by NumPy, in this thread. ``pin_memory()`` copies with as many threads
    as torch has, and each thread that calls it starts its own.
    """
    source = torch.from_numpy(values)
    if torch.device(device).type != "cuda":
        return source
    host = _page_locked(source)
    np.copyto(host.numpy(), values)
    return host


def device_numbers(
    values: npt.ArrayLike, device: str | torch.device, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return numbers as a tensor on a device, without waiting for the device.

    ``torch.tensor(values, device=device)`` waits until a GPU has computed all that it was given.

    Parameters
    ----------
    values : array_like
        Numbers of any shape.
    device : str or torch.device
        Device of the result.
    dtype : torch.dtype
        Number type of the result, to which the numbers are rounded.

    Returns
    -------
    Tensor
        Of the same shape.
    """
    host = torch.from_numpy(np.array(values)).to(dtype)
    return pinned(host, device).to(device, non_blocking=True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HostCopies:
    """Copies of tensors of one device on their way to the host.

    Attributes
    ----------
    tensors : list of Tensor
        On the host; for a GPU in page-locked memory, of which systems have little.
    arrival : torch.cuda.Event, optional
        Event after the last copy; None on the CPU.
    """

    tensors: list[Tensor]
    arrival: torch.cuda.Event | None

    @classmethod
    def of(cls, tensors: Sequence[Tensor]) -> "HostCopies":
        """Begin to copy tensors, without waiting for their device."""
        device = tensors[0].device
        if device.type == "cpu":
            return cls(tensors=[tensor.contiguous() for tensor in tensors], arrival=None)
        hosts = [_page_locked(tensor) for tensor in tensors]
        for host, tensor in zip(hosts, tensors, strict=True):
            host.copy_(tensor, non_blocking=True)
        # Who waits for a blocking event sleeps, and leaves the core to others.
        arrival = torch.cuda.Event(blocking=True)  # type: ignore[no-untyped-call]
        arrival.record(torch.cuda.current_stream(device))
        return cls(tensors=hosts, arrival=arrival)

    def arrays(self) -> list[Any]:
        """Wait for the copies, on any thread; return them as arrays, which share their memory."""
        if self.arrival is not None:
            self.arrival.synchronize()
        return [tensor.numpy() for tensor in self.tensors]


def _page_locked(tensor: Tensor) -> Tensor:
    """Return page-locked memory of the host for a contiguous copy of a tensor."""
    with memory_of_host():
        return torch.empty(tensor.shape, dtype=tensor.dtype, pin_memory=True)


@contextmanager
def memory_of_host() -> Iterator[None]:
    """Raise `MemoryError` for page-locked memory; CUDA names it as it names that of a GPU."""
    try:
        yield
    except RuntimeError as error:
        if not out_of_memory(error):
            raise
        raise MemoryError("not enough page-locked memory of the host") from None
