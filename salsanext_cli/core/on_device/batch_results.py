# SPDX-License-Identifier: MIT
"""Results of a batch on their way from a device, which the next batch need not wait for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from torch import Tensor

from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.core.on_device.regions import ROUNDS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchResults:
    """Results of B scans with P points in all, by name.

    Attributes
    ----------
    counts : sequence of int
        Number of points of each scan, with sum P.
    point_names, scan_names : tuple of str
        Names of the results of points (P, …), and of those of scans (B, …).
    copies : HostCopies
        The results of points, and then those of scans.
    """

    counts: Sequence[int]
    point_names: tuple[str, ...]
    scan_names: tuple[str, ...]
    copies: HostCopies

    @classmethod
    def of(
        cls,
        counts: Sequence[int],
        point_values: Mapping[str, Tensor],
        scan_values: Mapping[str, Tensor],
    ) -> Self:
        """Begin to copy results of points (P, …) and of scans (B, …) from their device."""
        return cls(
            counts=counts,
            point_names=tuple(point_values),
            scan_names=tuple(scan_values),
            copies=HostCopies.of([*point_values.values(), *scan_values.values()]),
        )

    def results_of(self, number: int) -> dict[str, Any]:
        """Wait for the results, and return copies of those of a scan, on any thread.

        No scan keeps the arrays of the batch.
        """
        arrays = self.copies.arrays()
        start = sum(self.counts[:number])
        points = slice(start, start + self.counts[number])
        point_arrays = zip(self.point_names, arrays, strict=False)
        scan_arrays = zip(self.scan_names, arrays[len(self.point_names) :], strict=True)
        results = {name: array[points].copy() for name, array in point_arrays}
        return results | {name: array[number].copy() for name, array in scan_arrays}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanOfBatch:
    """Scan of a batch whose results are on their way from a device.

    Attributes
    ----------
    batch : BatchResults
        Results of all scans of the batch.
    number : int
        Number of the scan in the batch.
    """

    batch: BatchResults
    number: int

    def results(self) -> dict[str, Any]:
        """Wait for the results of the scan, and return them by name."""
        return self.batch.results_of(self.number)


def final_results(
    computed: ScanOfBatch, compute_again: Callable[[int], ScanOfBatch]
) -> dict[str, Any]:
    """Return the results of a scan, computed again while its regions needed more rounds.

    Parameters
    ----------
    computed : ScanOfBatch
        The scan, after `ROUNDS` rounds; `is_final` among its results is whether they were enough.
    compute_again : callable
        Function of a number of rounds to the scan.

    Returns
    -------
    dict
        Results by name.
    """
    results = computed.results()
    rounds = ROUNDS
    while not results.get("is_final", True):
        rounds *= 2
        results = compute_again(rounds).results()
    return results
