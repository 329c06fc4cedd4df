# SPDX-License-Identifier: MIT
"""Scans that are read once and kept."""

from pathlib import Path

import numpy as np
import pytest
import torch
from calls import calls_of
from scan_stores import CPU
from scans import SMALL, make_scan, refused, write_sequence

from salsanext_cli import Scan, label_space
from salsanext_cli.core.errors import SalsanextError, TrainingError
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.on_device import scan_memory
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.data.on_device.scan_memory import (
    BYTES_PER_POINT,
    LEAST_HOST_RESERVE,
    ScanMemory,
)
from salsanext_cli.training.data.on_device.scan_store import ScanStore, half_of_blocks, half_values
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.memory import Memory

SPACE = label_space()


def source_of(folder: Path, count: int = 3) -> Source:
    scans = write_sequence(folder / "sequences" / "00", map(str, range(count)), count=400)
    return Source(files=find_scans(scans), space=SPACE, sensor=SMALL)


@pytest.mark.parametrize("jobs", [1, 3])
def test_scans_are_kept_in_order_with_their_targets(tmp_path: Path, jobs: int) -> None:
    rare = np.isin(SPACE.names, ["person", "pole"])
    sources = [source_of(tmp_path / "one"), source_of(tmp_path / "two", 2)]
    store = ScanStore(memory=ScanMemory(device=CPU), rare=rare, jobs=jobs)
    keys = store.read(sources)
    assert keys == [(n, file) for n, source in enumerate(sources) for file in source.files]
    for number, file in keys:
        annotated = sources[number].read(file, ())
        scan = store.whole[number, file]
        values = scan.values.float().numpy()
        np.testing.assert_allclose(values[:, :3], annotated.scan.points, rtol=2**-11, atol=1e-7)
        np.testing.assert_allclose(values[:, 3], annotated.scan.intensity, rtol=2**-11, atol=1e-7)
        np.testing.assert_array_equal(scan.targets, annotated.labels)
        pasted = store.pasted[number, file]
        is_rare = rare[annotated.labels]
        assert torch.equal(pasted.values, scan.values[is_rare])
        assert torch.equal(pasted.targets, scan.targets[is_rare])


def test_a_scan_is_read_once(tmp_path: Path) -> None:
    """A training on a fold of the scans reads only those that no fold before had."""
    source = source_of(tmp_path)
    store = ScanStore(memory=ScanMemory(device=CPU))
    first = Source(files=source.files[:2], space=SPACE, sensor=SMALL)
    with calls_of(Source.read) as calls:
        store.read([first])
        store.read([source])
        store.read([source])
    assert [call["file"] for call in calls] == source.files
    assert not store.pasted


def test_the_error_of_a_scan_is_that_of_its_file(tmp_path: Path) -> None:
    source = source_of(tmp_path)
    source.files[1].label_path.write_bytes(b"abc")
    with pytest.raises(SalsanextError) as caught:
        ScanStore(memory=ScanMemory(device=CPU), jobs=2).read([source])
    assert caught.value.subject == str(source.files[1].label_path)


def test_scans_that_the_host_cannot_hold_stay_on_the_device(monkeypatch) -> None:
    """Their whole number counts, before the first of them moves; "meta" stands for the GPU."""
    there = torch.device("meta")
    stored = StoredScan(
        values=torch.empty(6, 4, dtype=torch.float16, device=there),
        targets=torch.empty(6, dtype=torch.uint8, device=there),
    )
    store = ScanStore(memory=ScanMemory(device=there))
    assert not store.move_to_host()
    store.whole.update({(0, "a"): stored, (0, "b"): stored})
    store.pasted[0, "a"] = stored
    room = LEAST_HOST_RESERVE + 18 * BYTES_PER_POINT - 1
    monkeypatch.setattr(scan_memory, "memory_of", lambda _: Memory(total=9, available=room))
    refused(TrainingError, "memory", store.move_to_host)
    assert not store.memory.is_full
    assert {*store.whole.values(), *store.pasted.values()} == {stored}


def test_a_move_that_fails_waits_for_the_scans_that_have_moved(monkeypatch) -> None:
    """Batches of other streams read them; "meta" stands for the GPU."""
    stored = StoredScan(
        values=torch.empty(6, 4, dtype=torch.float16, device="meta"),
        targets=torch.empty(6, dtype=torch.uint8, device="meta"),
    )
    store = ScanStore(memory=ScanMemory(device=torch.device("meta")))
    store.whole.update({(0, "a"): stored, (0, "b"): stored})
    done: list[str] = []

    def put(memory: ScanMemory, values: torch.Tensor, targets: torch.Tensor) -> StoredScan:
        if done:
            raise MemoryError
        done.append("put")
        return stored

    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: None)
    monkeypatch.setattr(ScanMemory, "put", put)
    monkeypatch.setattr(ScanMemory, "wait", lambda memory: done.append("wait"))
    with pytest.raises(MemoryError):
        store.move_to_host()
    assert done == ["put", "wait"]


def test_half_of_the_blocks_leave_a_device_with_all_their_scans(monkeypatch) -> None:
    monkeypatch.setattr(scan_memory, "BLOCK_POINTS", 10)
    memory = ScanMemory(device=CPU)

    def scan(count: int) -> StoredScan:
        return memory.put(torch.zeros(count, 4).half(), torch.zeros(count, dtype=torch.uint8))

    blocks = [[scan(4), scan(6)], [scan(7)], [scan(8), scan(1), scan(1)]]
    for left, expected in ((3, 3), (2, 1), (1, 3)):
        scans = [each for block in blocks[-left:] for each in block]
        assert half_of_blocks(scans) == [*range(expected)]
    assert half_of_blocks([]) == []


def test_values_beyond_float16_are_no_measurements() -> None:
    scan = make_scan(6)
    points = scan.points.copy()
    points[0, 0] = 1e6
    points[1, 1] = np.nan
    intensity = np.float32([0.5, 7e4, -7e4, 2e6, np.nan, np.inf])
    values = half_values(Scan(points, intensity))
    assert values.dtype == np.float16
    assert np.isinf(values[0, 0])
    assert np.isnan(values[1, 1])
    assert values[:, 3].tolist() == [0.5, 65504.0, -65504.0, 0.0, 0.0, 0.0]
