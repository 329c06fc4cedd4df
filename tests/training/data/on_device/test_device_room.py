# SPDX-License-Identifier: MIT
"""Memory that the scans of a training need, beside that of the device and its host."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from scans import SMALL, write_sequence

from salsanext_cli import label_space
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.on_device import device_room
from salsanext_cli.training.data.on_device.device_room import DeviceRoom, bytes_of_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.memory import Memory
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.step_memory import StepMemory

PRECISIONS = ("float32", "bfloat16", "float16")
CPU, CUDA = torch.device("cpu"), torch.device("cuda:0")


@pytest.fixture(autouse=True)
def memory(monkeypatch: pytest.MonkeyPatch) -> dict[str, Memory]:
    """Return the memory of a device and its host, which tests may change."""
    memory = {"cpu": Memory(total=3000, available=1000), "cuda:0": Memory(total=500, available=400)}
    monkeypatch.setattr(device_room, "memory_of", memory.get)
    monkeypatch.setattr(device_room, "host_reserve", lambda host: host.total // 30)
    monkeypatch.setattr(device_room, "VALIDATION_BYTES", dict.fromkeys(PRECISIONS, 0))
    monkeypatch.setattr(device_room, "validation_precision", lambda device: "float16")
    return memory


def test_every_point_needs_nine_bytes(tmp_path: Path) -> None:
    """Of many scans some are read, evenly spaced."""
    sources = []
    for name, sizes in (("one", (100, 300)), ("two", 20 * (50,))):
        folder = tmp_path / name / "sequences" / "00"
        for number, size in enumerate(sizes):
            write_sequence(folder, [f"{number:03d}"], count=size)
        sources.append(Source(files=find_scans(folder), space=label_space(), sensor=SMALL))
    assert bytes_of_scans(sources) == 9 * (400 + 20 * 50)
    assert bytes_of_scans([]) == 0


@pytest.mark.parametrize(
    ("device", "reserve", "workers_here", "most"),
    [
        (CPU, 0, 1, 800),
        (CPU, 500, 1, 400),
        (CUDA, 0, 1, 1040),
        (CUDA, 300, 1, 800),
        (CUDA, 900, 1, 720),
        (CUDA, 0, 2, 680),
    ],
)
def test_scans_may_fill_four_fifths_of_device_and_host(
    monkeypatch, caplog, device, reserve, workers_here, most
):
    caplog.set_level(NOTICE)
    needed = {"first": 2 * most, "second": 2 * most + 2}
    monkeypatch.setattr(device_room, "BYTES_PER_IMAGE", 0)
    monkeypatch.setattr(device_room, "bytes_of_scans", needed.get)
    step = SimpleNamespace(room=reserve, recipe=Recipe())
    room = DeviceRoom(device=device, step=step, workers=2, workers_here=workers_here)
    assert room.has_room_for("first")
    assert not caplog.messages
    assert not room.has_room_for("second")
    assert len(caplog.messages) == 1


def test_unknown_memory_suffices(memory: dict[str, Memory]) -> None:
    memory.clear()
    room = DeviceRoom(device=CUDA, step=None)
    assert room.has_room_for([])
    assert room.reserve == 0


def test_steps_have_what_they_need_or_half_of_the_device() -> None:
    step = StepMemory.from_recipe(Recipe(), SMALL, "cuda")
    assert step is not None
    images = DeviceRoom(device=CUDA, step=step, workers=5)
    assert images.reserve == step.room + 5 * device_room.BYTES_PER_IMAGE
    assert DeviceRoom(device=CUDA, step=None).reserve == 250


@pytest.mark.parametrize(("device", "room"), [(CPU, 0), (CUDA, 90)])
def test_a_validation_on_a_gpu_has_what_it_needs(monkeypatch, device, room):
    """It comes after the steps, so that the larger of both counts."""
    monkeypatch.setattr(device_room, "BYTES_PER_IMAGE", 10)
    monkeypatch.setattr(device_room, "VALIDATION_BYTES", {"float16": 90})
    recipe = Recipe(batch=2, precision="bfloat16")
    for needed in (20, 100):
        step = SimpleNamespace(room=needed, recipe=recipe)
        assert DeviceRoom(device=device, step=step).reserve == max(needed, room) + 20


def test_a_validation_has_at_most_a_quarter_of_a_gpu(monkeypatch, memory) -> None:
    monkeypatch.setattr(device_room, "BYTES_PER_IMAGE", 0)
    monkeypatch.setattr(device_room, "VALIDATION_BYTES", {"float16": 300})
    room = DeviceRoom(device=CUDA, step=SimpleNamespace(room=20, recipe=Recipe()))
    for total, reserve in ((500, 125), (1200, 300), (2000, 300)):
        memory["cuda:0"] = Memory(total=total, available=total)
        assert room.reserve == reserve
    del memory["cuda:0"]
    assert room.reserve == 300
