# SPDX-License-Identifier: MIT
"""Batches that a GPU makes on a second stream while it learns from the batch before."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.training.data.dataset import Batch


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BegunBatch:
    """Batch whose kernels and copies may still run.

    Attributes
    ----------
    images : (B, 5, H, W) float32
        Images on the GPU.
    truth : (B, H, W) uint8
        Targets on the GPU.
    is_made : torch.cuda.Event
        Event after the last of them.
    """

    images: Tensor
    truth: Tensor
    is_made: torch.cuda.Event


def batches_ahead(makers: Iterable[Callable[[], Batch]], device: torch.device) -> Iterator[Batch]:
    """Yield the batches of functions; on a GPU each is begun before the one before is used.

    Parameters
    ----------
    makers : iterable of callable
        Functions that return images (B, 5, H, W) and targets (B, H, W) on the device.
    device : torch.device
        Device of the training.

    Yields
    ------
    Batch
        Images and targets on the device.
    """
    if device.type != "cuda":
        for make in makers:
            yield make()
        return
    # Of high priority, so that a batch is made before the GPU needs it.
    stream = torch.cuda.Stream(device, priority=-1)  # type: ignore[no-untyped-call]
    begun: BegunBatch | None = None
    for make in makers:
        following = _begin(make, stream)
        if begun is not None:
            yield _wait_for(begun, device)
        begun = following
    if begun is not None:
        yield _wait_for(begun, device)


def _begin(make: Callable[[], Batch], stream: torch.cuda.Stream) -> BegunBatch:
    """Begin a batch on a stream."""
    with torch.cuda.stream(stream):
        images, truth = make()
        return BegunBatch(images=images, truth=truth, is_made=stream.record_event())


def _wait_for(begun: BegunBatch, device: torch.device) -> Batch:
    """Let the stream of the training wait for a batch, but not the host; return the batch."""
    training = torch.cuda.current_stream(device)
    training.wait_event(begun.is_made)
    # Their memory is used again only after the step.
    begun.images.record_stream(training)
    begun.truth.record_stream(training)
    return begun.images, begun.truth
