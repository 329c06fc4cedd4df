# SPDX-License-Identifier: MIT
"""A GPU makes the samples that a CPU makes, one batch ahead, from its memory or from the host's."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from devices import CUDA, on_both, waits_refused
from scan_stores import maker_of, round_to_half, with_statistics
from scans import SMALL, write_sequence

from salsanext_cli import label_space
from salsanext_cli.commands.stages.train import train
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

SPACE = label_space()
RARE = np.isin(SPACE.names, ["bicycle", "person", "pole"])
PLAIN = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)
EVERYTHING = Recipe(
    epochs=2,
    batch=3,
    samples_per_epoch=9,
    crop_width=32,
    crop_on_class=0.5,
    **dict.fromkeys(("mix", "paste", "intensity", "mount", "view", "fewer_beams"), 0.5),
    **dict.fromkeys(("jitter", "holes", "no_intensity"), 0.5),
)


@pytest.fixture
def files(tmp_path: Path) -> list[ScanFile]:
    folder = write_sequence(tmp_path / "data/sequences/00", map(str, range(4)), count=2000)
    files = find_scans(folder)
    round_to_half(files)
    return files


def samples(files: list[ScanFile], recipe: Recipe) -> Samples:
    sensor = with_statistics(SMALL, files)
    source = Source(files=files, space=SPACE, sensor=sensor)
    return Samples(sources=[source], sensor=sensor, recipe=recipe, rare=RARE)


@on_both("float32")
def test_images_are_those_of_workers(files, device, precision):
    """But for pixels at a border, where a GPU rounds the angle of a point otherwise."""
    drawn = samples(files, PLAIN)
    keys = [(0, 1), (1, 3)]
    images, truth = maker_of(drawn, torch.device(device)).make(keys)
    for number, key in enumerate(keys):
        image, targets = drawn[key]
        is_same = np.isclose(images[number].cpu().numpy(), image, atol=1e-5).all(axis=0)
        assert is_same.mean() > 0.999
        assert (truth[number].cpu().numpy() == targets).mean() > 0.999


@pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)])
@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
def test_a_batch_waits_for_nothing(files, device):
    """On the CPU `test_the_host_waits_for_nothing_in_a_batch` says the same."""
    maker = maker_of(samples(files, EVERYTHING), torch.device(device))
    first = maker.make([(0, 1), (1, 3)])
    with waits_refused():
        second = maker.make([(0, 1), (1, 3)])
    for one, other in zip(first, second, strict=True):
        assert torch.equal(one, other)


@on_both("float32")
@pytest.mark.parametrize("is_full", [False, True])
def test_batches_ahead_are_those_made_one_by_one(files, device, precision, is_full):
    """From the memory of the device, or copied from the host for each batch."""
    drawn = samples(files, EVERYTHING)
    there = torch.device(device)
    maker = maker_of(drawn, there)
    is_streamed = is_full and device != "cpu"
    memory = ScanMemory(device=there, is_full=is_streamed)
    store = ScanStore(memory=memory, rare=RARE)
    batches = list(DeviceBatches(samples=drawn, store=store, device=there).batches(0))
    assert len(batches) == 6
    for (images, truth), keys in zip(batches, drawn.plan.batches(), strict=True):
        expected = maker.make(keys)
        assert images.device.type == truth.device.type == device
        assert torch.equal(images, expected[0])
        assert torch.equal(truth, expected[1])
    stored = next(iter(store.whole.values()))
    assert stored.values.is_pinned() == is_streamed


@on_both("float32")
def test_scans_that_leave_a_gpu_stay_the_same(files, device, precision):
    """On a CPU none leaves it."""
    there = torch.device(device)
    drawn = samples(files, EVERYTHING)
    store = ScanStore(memory=ScanMemory(device=there), rare=RARE)
    source = DeviceBatches(samples=drawn, store=store, device=there)
    stream = source.batches(0)
    next(stream)
    assert source.free_device() == (device == "cuda")
    assert not source.free_device()
    assert {scan.values.device.type for scan in store.whole.values()} == {"cpu"}
    expected = maker_of(drawn, there).make(next(drawn.plan.batches(3)))
    assert torch.equal(next(iter(source.batches(3)))[0], expected[0])


@on_both("float32", "bfloat16")
@pytest.mark.usefixtures("tiny_training")
def test_a_whole_training(files, tmp_path, device, precision):
    write_sequence(tmp_path / "data/sequences/08", ["0"], count=600)
    recipe = replace(EVERYTHING, precision=precision)
    results = [
        train(
            tmp_path / "data",
            tmp_path / number,
            recipe=recipe,
            sensor=SMALL,
            device=device,
            samples="device",
        )
        for number in ("one", "two")
    ]
    for result in results:
        assert all(math.isfinite(row["loss"]) and row["miou"] >= 0 for row in result.rows)
    first, second = ([row["loss"] for row in result.rows] for result in results)
    assert first == pytest.approx(second, rel=1e-2)
