# SPDX-License-Identifier: MIT
"""Batches of a training that its device makes, and the shares of its workers."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scan_stores import CPU
from scans import SMALL, refused, write_sequence

from salsanext_cli import label_space
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.dataset import Batch, SampleKey, Samples
from salsanext_cli.training.data.on_device.batch_maker import BatchMaker
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches, share_of
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.recipe import Recipe

SPACE = label_space()


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    """Return samples of seven scans and of two of a further data set."""
    sources = []
    for name, count in (("one", 7), ("two", 2)):
        folder = tmp_path_factory.mktemp(name) / "sequences" / "00"
        files = find_scans(write_sequence(folder, map(str, range(count)), count=300))
        sources.append(Source(files=files, space=SPACE, sensor=SMALL))
    recipe = Recipe(epochs=2, batch=5, samples_per_epoch=20, crop_width=32, mix=0.5, also=0.4)
    return Samples(
        sources=sources, sensor=SMALL, recipe=recipe, rare=np.zeros(SPACE.class_count, bool)
    )


def batches_of(samples: Samples, group: ProcessGroup) -> DeviceBatches:
    store = ScanStore(memory=ScanMemory(device=CPU))
    return DeviceBatches(samples=samples, store=store, device=CPU, group=group)


@pytest.mark.parametrize("rank", [0, 1])
def test_a_training_resumes_to_the_same_batches(samples: Samples, rank: int) -> None:
    group = ProcessGroup(rank=rank, size=2)
    whole = list(batches_of(samples, group).batches(0))
    rest = list(batches_of(samples, group).batches(3))
    assert [len(images) for images, _ in whole] == 8 * [3 - rank]
    assert len(rest) == 5
    for one, other in zip(whole[3:], rest, strict=True):
        assert torch.equal(one[0], other[0])
        assert torch.equal(one[1], other[1])
    assert not torch.equal(whole[0][0], whole[1][0])


def test_workers_hold_different_scans_and_draw_each_before_any_again(samples: Samples) -> None:
    groups = [ProcessGroup(rank=rank, size=2) for rank in range(2)]
    shares = [share_of(samples, group) for group in groups]
    for number, source in enumerate(samples.sources):
        files = [file for share in shares for file in share.sources[number].files]
        assert sorted(files) == sorted(source.files)
    for share in shares:
        keys = [key for batch in share.plan.batches() for key in batch]
        first = [index for _, index in keys if index < len(share.sources[0].files)]
        rounds = len(share.sources[0].files)
        assert sorted(first[:rounds]) == list(range(rounds))
        assert len(first) == pytest.approx(0.6 * len(keys), abs=1)
    assert {share.plan.steps for share in shares} == {samples.plan.steps}
    assert share_of(samples, ProcessGroup()) is samples


def test_workers_without_scans_of_a_data_set_have_all_of_them(samples: Samples) -> None:
    share = share_of(samples, ProcessGroup(rank=3, size=4))
    assert [len(source.files) for source in share.sources] == [1, 2]


def test_the_scans_of_a_step_are_those_of_all_workers(samples: Samples) -> None:
    groups = [ProcessGroup(rank=rank, size=2) for rank in range(2)]
    paths: list[Path] = []
    for group in groups:
        share = share_of(samples, group)
        (keys, *_) = share.plan.batches(4)
        paths += [share.scan_at(index)[1].path for _, index in keys]
    for group in groups:
        assert batches_of(samples, group).paths(4) == paths


def test_scans_leave_a_full_device_for_its_samples(samples: Samples, monkeypatch) -> None:
    """Once; then there is an error."""
    make = BatchMaker.make
    failures = [True, False, False, True]

    def exhausted(maker: BatchMaker, keys: list[SampleKey]) -> Batch:
        if failures and failures.pop(0):
            raise torch.OutOfMemoryError("no room")
        return make(maker, keys)

    expected = next(batches_of(samples, ProcessGroup()).batches(0))
    monkeypatch.setattr(BatchMaker, "make", exhausted)
    rooms = [True, False]
    monkeypatch.setattr(DeviceBatches, "_scans_leave", lambda _: rooms.pop(0))
    stream = batches_of(samples, ProcessGroup()).batches(0)
    assert torch.equal(next(stream)[0], expected[0])
    next(stream)
    refused(TrainingError, "samples", next, stream)
    assert not rooms


def test_workers_that_share_a_batch_repeat_no_step(samples: Samples, monkeypatch) -> None:
    monkeypatch.setattr(DeviceBatches, "_scans_leave", lambda _: True)
    assert batches_of(samples, ProcessGroup()).free_device()
    assert not batches_of(samples, ProcessGroup(rank=1, size=2)).free_device()
