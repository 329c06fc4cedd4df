# SPDX-License-Identifier: MIT
"""The order in which batches are begun and used; `cuda/test_samples.py` has their values."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import torch
from stored import CPU

from salsanext_cli.training.data.on_device.lookahead import batches_ahead

CUDA = torch.device("cuda")


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what happens on a GPU that only notes it."""
    events: list[str] = []
    begun = iter(range(100))

    def record_event() -> SimpleNamespace:
        number = next(begun)
        return SimpleNamespace(synchronize=lambda: events.append(f"waited for {number}"))

    empty = torch.empty
    stream = SimpleNamespace(record_event=record_event)
    monkeypatch.setattr(torch.cuda, "Stream", lambda *_, **__: stream)
    monkeypatch.setattr(torch.cuda, "stream", lambda _: nullcontext())
    monkeypatch.setattr(torch.cuda, "current_stream", lambda _: "training")
    monkeypatch.setattr(torch, "empty", lambda shape, dtype, pin_memory: empty(shape, dtype=dtype))
    return events


def makers(count: int, events: list[str]) -> list:
    def maker(number: int):
        def make():
            events.append(f"begun {number}")

            def record(stream):
                events.append(f"{number} is of {stream}")

            truth = torch.full((2, 3), number, dtype=torch.uint8)
            return SimpleNamespace(record_stream=record), truth

        return make

    return [maker(number) for number in range(count)]


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_gpu_begins_each_batch_before_the_one_before_is_used(events, count) -> None:
    for number, (_, truth) in enumerate(batches_ahead(makers(count, events), CUDA)):
        events.append(f"used {number}")
        assert (truth == number).all()
    expected = {
        0: [],
        1: ["begun 0", "waited for 0", "0 is of training", "used 0"],
        3: [
            *("begun 0", "begun 1", "waited for 0", "0 is of training", "used 0"),
            *("begun 2", "waited for 1", "1 is of training", "used 1"),
            *("waited for 2", "2 is of training", "used 2"),
        ],
    }
    assert events == expected[count]


def test_a_cpu_makes_a_batch_when_it_is_used() -> None:
    events: list[str] = []
    for number, _ in enumerate(batches_ahead(makers(2, events), CPU)):
        events.append(f"used {number}")
    assert events == ["begun 0", "used 0", "begun 1", "used 1"]
