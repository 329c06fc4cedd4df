# SPDX-License-Identifier: MIT
"""Memory for the points of scans: on the device while it has room, then on the host.

Scans on the host are copied to the device for each batch.
"""

import logging
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import memory_of_host
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.wording import setting
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.memory import Memory, memory_of

BLOCK_POINTS = 1 << 24  # Points of a block: few large blocks leave no gaps in the memory
BYTES_PER_POINT = 9  # Four values of float16, and a target
LEAST_HOST_RESERVE = 2_000_000_000  # Bytes of the host that stay free beside page-locked scans
HOST_RESERVE_SHARE = 0.1  # Of the memory of the host, if that is more

log = logging.getLogger(__name__)


@dataclass(slots=True, eq=False, kw_only=True)
class ScanMemory:
    """Blocks of memory that scans are put into, one after the other.

    Attributes
    ----------
    device : torch.device
        Device of the training.
    reserve : int
        Bytes of the device that stay free for the steps of the training.
    is_full : bool
        Whether further blocks are on the host of the device.
    """

    device: torch.device
    reserve: int = 0
    is_full: bool = False
    _block: StoredScan | None = None  # Block that is being filled
    _used: int = 0  # Its number of points

    def put(self, values: Tensor, targets: Tensor) -> StoredScan:
        """Copy a scan, values (N, 4) float16 and targets (N,) uint8, and return the copy.

        A GPU may still copy from page-locked memory when it returns; `wait` waits for it.
        """
        count = len(targets)
        if self._block is None or self._used + count > len(self._block):
            self._block = self._new_block(max(count, BLOCK_POINTS))
            self._used = 0
        place = slice(self._used, self._used + count)
        self._used += count
        stored = StoredScan(values=self._block.values[place], targets=self._block.targets[place])
        stored.values.copy_(values, non_blocking=True)
        stored.targets.copy_(targets, non_blocking=True)
        return stored

    def wait(self) -> None:
        """Wait until the scans that were put are there, for streams that read them."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    def fill(self) -> None:
        """Put further scans on the host, as if the device had no room."""
        if not self.is_full:
            self.is_full = True
            self._block = None
            text = "memory of %s is full: scans of the host are copied there for each batch"
            log.log(NOTICE, text, self.device)

    def _new_block(self, points: int) -> StoredScan:
        """Return memory for a number of points, on the device if it has room."""
        size = BYTES_PER_POINT * points
        if not self.is_full:
            try:
                if _has_room(str(self.device), size + self.reserve):
                    return _block(points, self.device)
            except torch.OutOfMemoryError:
                pass
            if self.device.type != "cpu":
                self.fill()
        if self.device.type == "cpu":
            raise _no_room()
        require_host_room(points)
        try:
            with memory_of_host():
                return _block(points, torch.device("cpu"), pin_memory=True)
        except MemoryError as error:
            raise _no_room() from error


def host_reserve(host: Memory) -> int:
    """Return the bytes of a host that stay free beside the page-locked scans of a GPU."""
    return max(LEAST_HOST_RESERVE, int(HOST_RESERVE_SHARE * host.total))


def require_host_room(points: int) -> None:
    """Raise `TrainingError` unless the host of a GPU has room for so many points."""
    host = memory_of("cpu")
    if host is not None and host.available < BYTES_PER_POINT * points + host_reserve(host):
        raise _no_room()


def _no_room() -> TrainingError:
    hint = f"read the scans for each batch: {setting('samples', 'workers')}"
    return TrainingError("memory", "has no room for the scans of the training", hint=hint)


def _has_room(device: str, size: int) -> bool:
    """Return whether a device has so many bytes; also if its memory is unknown."""
    memory = memory_of(device)
    return memory is None or memory.available >= size


def _block(points: int, device: torch.device, *, pin_memory: bool = False) -> StoredScan:
    """Return memory for a number of points."""
    values = torch.empty(points, 4, dtype=torch.float16, device=device, pin_memory=pin_memory)
    targets = torch.empty(points, dtype=torch.uint8, device=device, pin_memory=pin_memory)
    return StoredScan(values=values, targets=targets)
