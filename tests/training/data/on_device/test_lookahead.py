# SPDX-License-Identifier: MIT
"""The order in which batches are begun and used; `cuda/test_samples.py` has their values."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import torch
from scan_stores import CPU

from salsanext_cli.training.data.on_device.lookahead import batches_ahead

CUDA = torch.device("cuda")


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what happens on a GPU that only notes it."""
    events: list[str] = []
    begun = iter(range(100))

    def record_event() -> str:
        return f"event {next(begun)}"

    def wait_event(event: str) -> None:
        events.append(f"the step waits for {event}")

    stream = SimpleNamespace(record_event=record_event)
    training = SimpleNamespace(wait_event=wait_event)
    monkeypatch.setattr(torch.cuda, "Stream", lambda *_, **__: stream)
    monkeypatch.setattr(torch.cuda, "stream", lambda _: nullcontext())
    monkeypatch.setattr(torch.cuda, "current_stream", lambda _: training)
    return events


def makers(count: int, events: list[str]) -> list:
    """Return functions that note what becomes of the images; targets are alike."""

    def maker(number: int):
        def make():
            events.append(f"begun {number}")
            images = SimpleNamespace(record_stream=lambda _: events.append(f"{number} is used"))
            return images, SimpleNamespace(record_stream=lambda _: None, number=number)

        return make

    return [maker(number) for number in range(count)]


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_gpu_begins_each_batch_before_the_one_before_is_used(events, count) -> None:
    for number, (_, truth) in enumerate(batches_ahead(makers(count, events), CUDA)):
        events.append(f"step {number}")
        assert truth.number == number
    expected = {
        0: [],
        1: ["begun 0", "the step waits for event 0", "0 is used", "step 0"],
        3: [
            *("begun 0", "begun 1", "the step waits for event 0", "0 is used", "step 0"),
            *("begun 2", "the step waits for event 1", "1 is used", "step 1"),
            *("the step waits for event 2", "2 is used", "step 2"),
        ],
    }
    assert events == expected[count]


def test_a_cpu_makes_a_batch_when_it_is_used() -> None:
    events: list[str] = []
    for number, _ in enumerate(batches_ahead(makers(2, events), CPU)):
        events.append(f"step {number}")
    assert events == ["begun 0", "step 0", "begun 1", "step 1"]
