# SPDX-License-Identifier: MIT
"""Labelled scans of a training, read once and kept in memory with 16-bit values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import joblib
import numpy as np
import numpy.typing as npt
import torch

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.device_copies import pinned_array
from salsanext_cli.core.records import MAX_INTENSITY, Mask, Scan
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory, require_host_room
from salsanext_cli.training.data.reading_progress import with_progress
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.data.targets import ClassSets

ScanKey = tuple[int, ScanFile]  # Number of the data set, file of the scan
MAX_HALF = float(np.finfo(np.float16).max)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReadScan:
    """Scan on the host, and its points of rare targets if those are pasted."""

    whole: StoredScan
    pasted: StoredScan | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScanStore:
    """Scans in memory.

    Attributes
    ----------
    memory : ScanMemory
        Where the points are.
    sets : tuple of tuple of int
        Sets of classes among the targets.
    rare : (T,) bool, optional
        Targets whose points are pasted; none without pasting.
    jobs : int
        Number of threads that read.
    whole : dict of StoredScan
        The scans.
    pasted : dict of StoredScan
        Their rare points, empty without pasting.
    """

    memory: ScanMemory
    sets: ClassSets = ()
    rare: Mask | None = None
    jobs: int = 1
    whole: dict[ScanKey, StoredScan] = field(default_factory=dict)
    pasted: dict[ScanKey, StoredScan] = field(default_factory=dict)

    def read(self, sources: Sequence[Source]) -> list[ScanKey]:
        """Read the scans of data sets that are not in memory yet; return the keys of all."""
        keys = [(number, file) for number, source in enumerate(sources) for file in source.files]
        missing = [key for key in keys if key not in self.whole]
        if not missing:
            return keys
        device = self.memory.device
        run = joblib.Parallel(self.jobs, backend="threading", return_as="generator")
        calls = [
            joblib.delayed(read_half)(sources[number], file, self.sets, self.rare, device)
            for number, file in missing
        ]
        scans = with_progress(run(calls), len(missing))
        for key, scan in zip(missing, scans, strict=True):
            self._put(key, scan)
        self.memory.wait()
        return keys

    def move_to_host(self) -> bool:
        """Move half of the scans from a GPU to its host; return whether there were any.

        Memory is free only when the last scan of a block has left it, so whole blocks move.

        Raises
        ------
        TrainingError
            If the host has no room for them; then none has moved.
        """
        on_device = [
            (scans, key)
            for scans in (self.whole, self.pasted)
            for key, scan in scans.items()
            if scan.values.device.type != "cpu"
        ]
        if not on_device:
            return False
        moving = [on_device[i] for i in half_of_blocks([scans[key] for scans, key in on_device])]
        require_host_room(sum(len(scans[key]) for scans, key in moving))
        # A batch that was begun may still read them, on a stream of its own.
        torch.cuda.synchronize(self.memory.device)
        self.memory.fill()
        try:
            for scans, key in moving:
                scans[key] = self.memory.put(scans[key].values, scans[key].targets)
        finally:
            # Also after a failure: scans that have moved are read by others at once.
            self.memory.wait()
        torch.cuda.empty_cache()
        return True

    def _put(self, key: ScanKey, scan: ReadScan) -> None:
        self.whole[key] = self.memory.put(scan.whole.values, scan.whole.targets)
        if scan.pasted is not None:
            self.pasted[key] = self.memory.put(scan.pasted.values, scan.pasted.targets)


def half_of_blocks(scans: Sequence[StoredScan]) -> list[int]:
    """Return the indices of the scans in half of their blocks of memory, at least in one."""
    block_of_scan = [scan.values.untyped_storage().data_ptr() for scan in scans]
    blocks = [*dict.fromkeys(block_of_scan)]
    chosen = {*blocks[: math.ceil(len(blocks) / 2)]}
    return [i for i, block in enumerate(block_of_scan) if block in chosen]


def read_half(
    source: Source, file: ScanFile, sets: ClassSets, rare: Mask | None, device: torch.device
) -> ReadScan:
    """Read a scan and its targets as they are stored, with its rare targets.

    They are on the host, in memory that the device reads directly.
    """
    annotated = source.read(file, sets)
    values = half_values(annotated.scan)
    targets = annotated.labels
    whole = _on_host(values, targets, device)
    if rare is None:
        return ReadScan(whole=whole)
    is_rare = rare[targets]
    return ReadScan(whole=whole, pasted=_on_host(values[is_rare], targets[is_rare], device))


def _on_host(
    values: npt.NDArray[np.float16], targets: TrainIds, device: torch.device
) -> StoredScan:
    return StoredScan(values=pinned_array(values, device), targets=pinned_array(targets, device))


def half_values(scan: Scan) -> npt.NDArray[np.float16]:
    """Return x, y, z and intensity of a scan, (N, 4) float16.

    Coordinates beyond 65 km become infinite, an intensity beyond `MAX_INTENSITY` becomes 0.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        is_usable = np.abs(scan.intensity) <= MAX_INTENSITY
        intensity = np.where(is_usable, scan.intensity.clip(-MAX_HALF, MAX_HALF), 0)
        return np.column_stack([scan.points, intensity]).astype(np.float16)
