# SPDX-License-Identifier: MIT
"""The processes that train one network together, as torchrun starts them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.errors import SalsanextError, UsageError
from salsanext_cli.inference.network import choose_device

PATIENCE = timedelta(hours=12)
"""How long the others wait while the leader counts labels, writes and draws."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ProcessGroup:
    """Who else trains this network; what is said of all workers costs nothing for one alone.

    Attributes
    ----------
    rank : int
        Number of this process; 0 leads: it alone writes and reports.
    size : int
        How many there are.
    """

    rank: int = 0
    size: int = 1

    @property
    def is_main(self) -> bool:
        """Whether this process writes and reports."""
        return self.rank == 0

    def sum(self, tensor: Tensor) -> Tensor:
        """Return the sum of the tensors of all workers, without a gradient."""
        if self.size > 1:
            tensor = tensor.clone()
            dist.all_reduce(tensor)
        return tensor

    def gather(self, tensor: Tensor) -> list[Tensor]:
        """Return the tensors of all workers by rank; the last of their dimensions may differ."""
        if self.size == 1:
            return [tensor]
        lengths = torch.zeros(self.size, dtype=torch.int64, device=tensor.device)
        lengths[self.rank] = tensor.shape[-1]
        dist.all_reduce(lengths)
        padded = F.pad(tensor, (0, int(lengths.max()) - tensor.shape[-1])).contiguous()
        found = [torch.empty_like(padded) for _ in range(self.size)]
        dist.all_gather(found, padded)
        return [each[..., :n] for each, n in zip(found, lengths.tolist(), strict=True)]

    def on_main(self, work: Callable[[], T]) -> T:
        """Return what `work` returns to the leader; the others wait, and do not do it.

        A `SalsanextError` of the leader is raised by all, and the others know that it says it.
        """
        if self.size == 1:
            return work()
        answer: list[Any] = [None]
        if self.is_main:
            try:
                answer = [work()]
            except SalsanextError as error:
                answer = [error]
        dist.broadcast_object_list(answer)
        if isinstance(answer[0], SalsanextError):
            answer[0].reported_elsewhere = not self.is_main
            raise answer[0]
        result: T = answer[0]
        return result


SINGLE_PROCESS = ProcessGroup()


def group_of_environment() -> ProcessGroup:
    """Return the group that torchrun put this process into; `SINGLE_PROCESS` without torchrun."""
    if not (dist.is_available() and dist.is_torchelastic_launched()):
        return SINGLE_PROCESS
    return ProcessGroup(int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"]))


@contextmanager
def process_group(device: str) -> Iterator[tuple[ProcessGroup, torch.device]]:
    """Join the team of this process, and choose its device, as long as the body runs.

    Parameters
    ----------
    device : str
        As `choose_device` takes it; each worker of a machine takes a GPU of its own.

    Raises
    ------
    UsageError
        If the device does not exist or is one GPU for several workers.
    """
    group, place = group_of_environment(), choose_device(device)
    if group.size == 1:
        yield group, place
        return
    if place.type == "cuda":
        if place.index is not None:
            found = f"one GPU for {group.size} workers"
            raise UsageError(f"device {device}", found, "cuda, cpu or auto")
        place = choose_device(f"cuda:{os.environ['LOCAL_RANK']}")
        torch.cuda.set_device(place)
    dist.init_process_group("nccl" if place.type == "cuda" else "gloo", timeout=PATIENCE)
    try:
        yield group, place
    finally:
        dist.destroy_process_group()
