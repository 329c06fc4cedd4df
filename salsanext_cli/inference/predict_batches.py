# SPDX-License-Identifier: MIT
"""Predict several scans at a time: while some are computed, others are read and written."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from itertools import islice

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.classes import TrainIds
from salsanext_cli.errors import FormatError, SalsanextError
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.coverage import FieldOfViewCoverage, field_of_view_coverage
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.inference.batches import BatchLabeller, Labelled, Points
from salsanext_cli.inference.network import Network
from salsanext_cli.parallel.tasks import Attempt
from salsanext_cli.records import Float, Int
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.uncertainty.monte_carlo import AT_ONCE

READERS, WRITERS = 4, 4
"""Threads; both mostly wait for the system."""
AHEAD = 3
"""Batches that are read before they are needed, or not yet written, at most."""
MOST = 16
"""Scans of a batch on a GPU, unless the number is given; as many as a worker is sent together."""

Write = Callable[[ScanFile, TrainIds, TrainIds, Float | None, Int], None]
"""Takes a scan, labels of points, labels of pixels, perhaps probabilities, pixels of points."""


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A scan that has been read.

    Attributes
    ----------
    points : Points
        In pinned memory if they go to a GPU.
    seen : Sight
        How much of it is in view.
    """

    points: Points
    seen: FieldOfViewCoverage


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a writer needs, on its way to this machine's memory."""

    labels: Tensor
    pixel_labels: Tensor
    probabilities: Tensor | None
    pixel_of_point: Tensor
    arrived: torch.cuda.Event | None


def usual_size(network: Network) -> int:
    """Return how many scans are computed together where nobody says: on a CPU one."""
    if network.device.type == "cpu":
        return 1
    return max(1, min(MOST, AT_ONCE // (network.sensor.height * network.sensor.width)))


def predict_batches(
    files: Iterable[ScanFile],
    network: Network,
    knn: KnnParameters,
    size: int,
    write: Write,
    *,
    probabilities: bool,
) -> Iterator[Attempt]:
    """Predict scans in batches.

    Parameters
    ----------
    files : iterable of ScanFile
        What to predict, in this order.
    network : Network
        Its device computes everything.
    knn : KnnParameters
        Neighbours of the clean-up.
    size : int
        Scans of a batch.
    write : callable
        Writes the results of a scan; called in threads.
    probabilities : bool
        Whether it wants probabilities; they are large.
    """
    labeller = _labeller(network, knn, size)
    waiting, unwritten = iter(files), deque[tuple[ScanFile, Loaded, Future[None]]]()
    reading = deque[tuple[ScanFile, Future[Loaded]]]()
    readers, writers = ThreadPoolExecutor(READERS), ThreadPoolExecutor(WRITERS)
    try:
        while True:
            for file in islice(waiting, AHEAD * size - len(reading)):
                reading.append((file, readers.submit(_read, file, network)))
            if not reading:
                break
            batch = [reading.popleft() for _ in range(min(size, len(reading)))]
            loaded = []
            for file, future in batch:
                try:
                    loaded.append((file, future.result()))
                except SalsanextError as error:
                    yield file, None, error
            for file, scan, result in _label(labeller, loaded):
                if result is None:
                    yield file, None, _too_large(file, scan, network)
                    continue
                found = _fetch(result, probabilities)
                # The mark of temporary files is in the context.
                job = writers.submit(copy_context().run, _write, write, file, found)
                unwritten.append((file, scan, job))
            while len(unwritten) > AHEAD * size:
                yield _written(*unwritten.popleft())
        while unwritten:
            yield _written(*unwritten.popleft())
    finally:
        readers.shutdown(cancel_futures=True)
        writers.shutdown()


class _Held(threading.local):
    """What this thread recorded last, for the next scans that it is sent."""

    labeller: BatchLabeller | None = None
    size = 0


_HELD = _Held()


def _labeller(network: Network, knn: KnnParameters, size: int) -> BatchLabeller:
    held = _HELD.labeller
    if held is None or (held.network, held.knn, _HELD.size) != (network, knn, size):
        held = _HELD.labeller = BatchLabeller(network, knn, size)
        _HELD.size = size
    return held


def _label(
    labeller: BatchLabeller, loaded: list[tuple[ScanFile, Loaded]]
) -> Iterator[tuple[ScanFile, Loaded, Labelled | None]]:
    """Label scans; what does not even fit alone has no result."""
    try:
        results: list[Labelled | None] = [*labeller.label([scan.points for _, scan in loaded])]
    except torch.OutOfMemoryError:
        results = [_label_alone(labeller, scan) for _, scan in loaded]
    for (file, scan), result in zip(loaded, results, strict=True):
        yield file, scan, result


def _label_alone(labeller: BatchLabeller, scan: Loaded) -> Labelled | None:
    try:
        return labeller.label([scan.points])[0]
    except torch.OutOfMemoryError:
        return None


def _too_large(file: ScanFile, scan: Loaded, network: Network) -> FormatError:
    found = f"{len(scan.points[0])} points are too many for the memory of {network.device}"
    return FormatError(file.path, found, "a smaller scan", "label it with --device cpu")


def _read(file: ScanFile, network: Network) -> Loaded:
    sensor = network.sensor
    scan = read_scan(file.path, intensity_scale=sensor.intensity_scale)
    points, intensity = torch.from_numpy(scan.points), torch.from_numpy(scan.intensity)
    if network.device.type == "cuda":
        points, intensity = points.pin_memory(), intensity.pin_memory()
    return Loaded((points, intensity), field_of_view_coverage(scan, sensor))


def _fetch(result: Labelled, probabilities: bool) -> Found:
    """Begin to bring results to this machine's memory; nobody waits here."""
    on_gpu = result.labels.device.type == "cuda"
    wanted = [result.labels, result.pixel_labels, result.pixel_of_point]
    labels, pixel_labels, pixel_of_point = (part.to("cpu", non_blocking=True) for part in wanted)
    softmax = result.probabilities.to("cpu", non_blocking=True) if probabilities else None
    arrived = torch.cuda.Event() if on_gpu else None  # type: ignore[no-untyped-call]
    if arrived:
        arrived.record(torch.cuda.current_stream(result.labels.device))
    return Found(labels, pixel_labels, softmax, pixel_of_point, arrived)


def _write(write: Write, file: ScanFile, found: Found) -> None:
    if found.arrived:
        found.arrived.synchronize()
    softmax = None if found.probabilities is None else found.probabilities.numpy()
    pixels = np.asarray(found.pixel_of_point.numpy())
    write(file, found.labels.numpy(), found.pixel_labels.numpy(), softmax, pixels)


def _written(file: ScanFile, scan: Loaded, job: Future[None]) -> Attempt:
    try:
        job.result()
    except SalsanextError as error:
        return file, None, error
    return file, scan.seen, None
