# SPDX-License-Identifier: MIT
"""Process group of a training: the workers that torchrun started to train one network."""

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from salsanext_cli.core.engines.device import PRECISIONS, choose_device
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.training.failure_watch import LEAVING_S, POLL_S, FailureWatch

TIMEOUT = timedelta(minutes=15)  # Longest time that a collective takes

T = TypeVar("T")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessGroup:
    """Rank of this process among the workers; in a group of one, collectives do nothing."""

    rank: int = 0
    size: int = 1
    store: Any = None  # `Store` of torch that all workers share; None in a group of one
    # Notices of the training that this process has logged
    notices: set[str] = field(default_factory=set, compare=False, repr=False)

    @property
    def is_main(self) -> bool:
        """True in the process that writes and reports."""
        return self.rank == 0

    def notice_once(self, text: str) -> None:
        """Log a notice in the main process, once in the training of the group."""
        if self.is_main and text not in self.notices:
            self.notices.add(text)
            log.log(NOTICE, "%s", text)

    def sum(self, tensor: Tensor) -> Tensor:
        """Return the sum of the tensors of all workers, without a gradient."""
        if self.size > 1:
            tensor = tensor.clone()
            dist.all_reduce(tensor)
        return tensor

    def gather(self, tensor: Tensor, lengths: Sequence[int] | None = None) -> list[Tensor]:
        """Return the tensors of all workers by rank; their last dimension may differ.

        Without its lengths, the workers exchange them first, and wait for their devices.
        """
        if self.size == 1:
            return [tensor]
        if lengths is None:
            length = torch.zeros(self.size, dtype=torch.int64, device=tensor.device)
            length[self.rank] = tensor.shape[-1]
            lengths = self.sum(length).tolist()
        padded = F.pad(tensor, (0, max(lengths) - tensor.shape[-1])).contiguous()
        gathered = [torch.empty_like(padded) for _ in range(self.size)]
        dist.all_gather(gathered, padded)
        return [part[..., :length] for part, length in zip(gathered, lengths, strict=True)]

    def broadcast(self, tensors: Iterable[Tensor]) -> None:
        """Overwrite tensors with those of the main worker."""
        if self.size > 1:
            for tensor in tensors:
                dist.broadcast(tensor, 0)

    def on_main(self, work: Callable[[], T]) -> T:
        """Call a function in the main worker; all workers return its result or raise its error."""
        if self.store is None:
            return work()
        answer: list[Any] = [None]
        done = f"call {self.store.add(f'calls of {self.rank}', 1)} done"
        if self.is_main:
            try:
                answer = [work()]
            except SalsanextError as error:
                answer = [error]
            self.store.set(done, "")
        # The call may take hours, longer than a collective may.
        while not self.store.check([done]):
            time.sleep(POLL_S)
        dist.broadcast_object_list(answer)
        if isinstance(answer[0], SalsanextError):
            answer[0].reported_elsewhere = not self.is_main
            raise answer[0]
        return answer[0]


SINGLE_PROCESS = ProcessGroup()  # Group of a training without torchrun


def group_of_environment() -> ProcessGroup:
    """Return the group that torchrun put this process into; `SINGLE_PROCESS` without torchrun."""
    if not (dist.is_available() and dist.is_torchelastic_launched()):
        return SINGLE_PROCESS
    return ProcessGroup(rank=int(os.environ["RANK"]), size=int(os.environ["WORLD_SIZE"]))


@contextmanager
def process_group(device: str) -> Iterator[tuple[ProcessGroup, torch.device]]:
    """Join the group of this process, and choose its device, a GPU of its own if there is one."""
    group = group_of_environment()
    chosen = _device(device, group)
    if group.size == 1:
        yield group, chosen
        return
    store, rank, size = next(dist.rendezvous("env://", timeout=TIMEOUT))  # type: ignore[attr-defined]
    is_gpu = chosen.type == "cuda"
    dist.init_process_group(
        "nccl" if is_gpu else "gloo",
        store=store,
        rank=rank,
        world_size=size,
        timeout=TIMEOUT,
        device_id=chosen if is_gpu else None,
    )
    watch = FailureWatch(store, rank, size)
    watch.start()
    try:
        yield ProcessGroup(rank=rank, size=size, store=store), chosen
        # A worker that leaves early closes connections that others still read from.
        dist.barrier()
        watch.leave()
        # After a failure this would wait for the other workers for ever.
        dist.destroy_process_group()
    except BaseException as error:
        watch.report(error)
        raise
    finally:
        # The others notice a failure. Threads of gloo that still free tensors abort a process
        # that ends meanwhile; they need the GIL, and torch's wrapper keeps them from being joined.
        time.sleep(LEAVING_S)


def _device(name: str, group: ProcessGroup) -> torch.device:
    """Return the device of this worker; of several GPUs, the one with its local number."""
    chosen = torch.device(choose_device(name))
    if group.size == 1 or chosen.type != "cuda":
        return chosen
    if chosen.index is not None:
        problem = f"names one GPU for {group.size} workers"
        error = UsageError(f"device {name}", problem, "cuda, cpu or auto")
        error.reported_elsewhere = not group.is_main
        raise error
    gpu = torch.device(choose_device(f"cuda:{os.environ['LOCAL_RANK']}"))
    torch.cuda.set_device(gpu)
    return gpu


def agreed_precision(precision: str, device: torch.device | str, group: ProcessGroup) -> str:
    """Return the number type of all workers; float32 with a notice if they differ."""
    gathered = group.gather(torch.tensor([PRECISIONS.index(precision)], device=device))
    precisions = sorted({PRECISIONS[int(number)] for number in gathered})
    if len(precisions) == 1:
        return precision
    text = f"workers have different number types ({', '.join(precisions)}): all use float32"
    group.notice_once(text)
    return "float32"


def data_parallel(module: nn.Module, device: torch.device, group: ProcessGroup) -> nn.Module:
    """Return the module to call in training, wrapped to sum the gradients of several workers."""
    if group.size == 1:
        return module
    if device.type == "cuda":
        # torch computes statistics of the whole batch on GPUs only.
        module = nn.SyncBatchNorm.convert_sync_batchnorm(module)  # type: ignore[no-untyped-call]
        return DistributedDataParallel(module, [device])
    if group.is_main and any(isinstance(layer, nn.BatchNorm2d) for layer in module.modules()):
        log.warning("on CPUs batch norm uses the statistics of each worker's share of a batch")
    return DistributedDataParallel(module)
