# SPDX-License-Identifier: MIT
"""Task that needs a network, which each worker loads once."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import isgeneratorfunction
from itertools import islice
from typing import Any

from salsanext_cli.engines.device import MAX_BATCH_PIXELS, choose_device
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import FormatError, out_of_memory
from salsanext_cli.parallel.tasks import Attempt, Steps, one_by_one, overlapping
from salsanext_cli.parallel.worker import own_device
from salsanext_cli.results.layout import ScanFile

MAX_BATCH_SCANS = 16
"""Scans computed together on a GPU; as many as a worker is sent together."""


@dataclass(frozen=True, slots=True)
class NetworkTask:
    """Function of a scan and a network."""

    # Takes a scan file and a network; picklable. It returns the result or yields `Steps`, which
    # overlap on a CPU
    function: Callable[[ScanFile, Network], Any]
    settings: NetworkSettings  # Resolved: what the workers load
    # The same, loaded in this process; it is not sent to others
    network: Network | None = field(default=None, compare=False)
    # Does the same to several scans together, and yields an attempt of each
    batch_function: Callable[[Sequence[ScanFile], Network], Iterator[Attempt]] | None = None
    # Scans computed together; by default one on a CPU, as many as keep it busy on a GPU
    batch: int | None = None

    def open(self) -> Callable[[Iterable[ScanFile]], Iterator[Attempt]]:
        """Load the network, unless it is there, and decide between one by one and batches."""
        network = self.network
        if network is None:
            network = replace(self.settings, device=_device(self.settings.device)).load()
        size, several = self.batch or default_batch(network), self.batch_function
        if several is None or (size == 1 and network.device == "cpu"):

            def steps(file: ScanFile) -> Steps:
                with named_if_too_large(file, network):
                    yield from self.function(file, network)

            def whole(file: ScanFile) -> Any:
                with named_if_too_large(file, network):
                    return self.function(file, network)

            if not isgeneratorfunction(self.function):
                return partial(one_by_one, whole)
            if network.device == "cpu":
                return partial(overlapping, steps)
            return partial(one_by_one, lambda file: [*steps(file)][-1])

        def batched_attempts(files: Iterable[ScanFile]) -> Iterator[Attempt]:
            waiting = iter(files)
            while batch := tuple(islice(waiting, size)):
                yield from several(batch, network)

        return batched_attempts

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.function, self.settings, None, self.batch_function, self.batch)
        return NetworkTask, parts


def _device(name: str) -> str:
    """Return the device of this process; a GPU of its own if it is a worker."""
    if choose_device(name) == "cpu":
        return "cpu"
    import torch

    return own_device(name, torch.cuda.device_count())


@contextmanager
def named_if_too_large(file: ScanFile, network: Network) -> Iterator[None]:
    """Turn memory that runs out into an error of one scan."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not out_of_memory(error):
            raise
        found = f"is too large for the memory of {network.device}"
        raise FormatError(file.path, found, remedy="use --device cpu") from error


def default_batch(network: Network) -> int:
    """Return how many scans are computed together unless a number is given: one on a CPU."""
    if network.device == "cpu":
        return 1
    pixels = network.sensor.height * network.sensor.width
    return max(1, min(MAX_BATCH_SCANS, MAX_BATCH_PIXELS // pixels))
