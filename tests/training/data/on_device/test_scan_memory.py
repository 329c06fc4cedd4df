# SPDX-License-Identifier: MIT
"""Memory for scans: blocks of the device, then of the host."""

import pytest
import torch
from host_waits import META, WaitsRefused
from scan_stores import CPU
from scans import refused

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.training.data.on_device import scan_memory
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.data.on_device.scan_memory import (
    BYTES_PER_POINT,
    LEAST_HOST_RESERVE,
    ScanMemory,
    require_host_room,
)
from salsanext_cli.training.memory import Memory


def scan(count: int, value: int) -> tuple[torch.Tensor, torch.Tensor]:
    values = torch.full((count, 4), value, dtype=torch.float16)
    return values, torch.full((count,), value, dtype=torch.uint8)


def test_scans_lie_one_after_the_other_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_memory, "BLOCK_POINTS", 10)
    memory = ScanMemory(device=CPU)
    stored = [memory.put(*scan(count, number)) for number, count in enumerate((4, 6, 0, 3, 25, 2))]
    for number, (block, count) in enumerate(zip(stored, (4, 6, 0, 3, 25, 2), strict=True)):
        assert len(block) == count
        assert (block.values == number).all()
        assert (block.targets == number).all()
    blocks = [block.values.untyped_storage().data_ptr() for block in stored]
    assert blocks[0] == blocks[1] == blocks[2]
    assert len(set(blocks)) == 4


def test_scans_without_room_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_memory, "BLOCK_POINTS", 10)
    room = {"cpu": 10 * BYTES_PER_POINT + 100}
    monkeypatch.setattr(
        scan_memory, "memory_of", lambda device: Memory(total=10**9, available=room[device])
    )
    memory = ScanMemory(device=CPU, reserve=100)
    memory.put(*scan(10, 1))
    room["cpu"] -= 1
    refused(TrainingError, "memory", memory.put, *scan(1, 1))
    assert torch.equal(memory.put(*scan(0, 1)).targets, torch.zeros(0, dtype=torch.uint8))


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bool]]:
    """Return the devices of new blocks, and whether they are pinned; all are on the CPU."""
    monkeypatch.setattr(scan_memory, "BLOCK_POINTS", 10)
    blocks: list[tuple[str, bool]] = []
    block = scan_memory._block

    def note(points: int, device: torch.device, *, pin_memory: bool = False) -> StoredScan:
        blocks.append((device.type, pin_memory))
        return block(points, CPU)

    monkeypatch.setattr(scan_memory, "_block", note)
    return blocks


def test_a_full_gpu_has_further_scans_on_its_host(blocks, monkeypatch, caplog):
    """Even if it becomes less full; the log contains it once."""
    caplog.set_level(NOTICE)
    sizes = iter([190, 189, 10**9, 10**9])
    room = {"cuda": lambda: next(sizes), "cpu": lambda: 90 + LEAST_HOST_RESERVE}
    monkeypatch.setattr(
        scan_memory, "memory_of", lambda device: Memory(total=10**9, available=room[device]())
    )
    memory = ScanMemory(device=torch.device("cuda"), reserve=100)
    for value in range(3):
        assert memory.put(*scan(10, value)).targets.tolist() == 10 * [value]
    assert blocks == [("cuda", False), ("cpu", True), ("cpu", True)]
    assert len(caplog.messages) == 1
    room["cpu"] = lambda: 89 + LEAST_HOST_RESERVE
    refused(TrainingError, "memory", memory.put, *scan(10, 1))


@pytest.mark.parametrize(("total", "reserve"), [(10**9, 2 * 10**9), (10**12, 10**11)])
def test_a_tenth_of_the_host_stays_free(monkeypatch, total, reserve):
    room = 90 + reserve
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: Memory(total=total, available=room))
    require_host_room(10)
    refused(TrainingError, "memory", require_host_room, 11)


def test_memory_that_another_program_takes_meanwhile_is_no_error(blocks, monkeypatch):
    block = scan_memory._block

    def exhausted(points: int, device: torch.device, **how: bool) -> StoredScan:
        if device.type == "cuda":
            raise torch.OutOfMemoryError("no room")
        return block(points, device, **how)

    monkeypatch.setattr(scan_memory, "_block", exhausted)
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: None)
    memory = ScanMemory(device=torch.device("cuda"))
    memory.put(*scan(4, 1))
    assert blocks == [("cpu", True)]


def test_a_host_without_page_locked_memory_has_no_room(monkeypatch):
    """CUDA names it as it names the memory of a GPU, which fewer scans in a batch would spare."""

    def exhausted(points: int, device: torch.device, *, pin_memory: bool = False) -> StoredScan:
        raise RuntimeError("CUDA error: out of memory")

    monkeypatch.setattr(scan_memory, "_block", exhausted)
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: None)
    memory = ScanMemory(device=torch.device("cuda"), is_full=True)
    refused(TrainingError, "memory", memory.put, *scan(4, 1))


def test_filled_memory_leaves_the_rest_of_its_block(blocks, monkeypatch):
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: None)
    memory = ScanMemory(device=torch.device("cuda"))
    memory.put(*scan(4, 1))
    memory.fill()
    memory.put(*scan(4, 1))
    assert blocks == [("cuda", False), ("cpu", True)]


def test_the_host_waits_for_no_scan(monkeypatch):
    """Scans of the reading threads are in page-locked memory; "meta" stands for the GPU."""
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: None)
    memory = ScanMemory(device=META)
    values, targets = scan(4, 1)
    with WaitsRefused(pinned=[values, targets]):
        stored = memory.put(values, targets)
    assert stored.values.device == stored.targets.device == META
