# SPDX-License-Identifier: MIT
"""Results of a batch on their way from a device, which the next batch need not wait for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.core.on_device.device_labels import DeviceLabels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledBatch:
    """Results of B scans with P points in all, as attributes of `DeviceLabels`.

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
    ) -> "LabelledBatch":
        """Begin to copy results of points (P, …) and of scans (B, …) from their device."""
        return cls(
            counts=counts,
            point_names=tuple(point_values),
            scan_names=tuple(scan_values),
            copies=HostCopies.of([*point_values.values(), *scan_values.values()]),
        )

    def labels_of(self, number: int) -> DeviceLabels:
        """Wait for the results, and return copies of those of a scan, on any thread.

        No scan keeps the arrays of the batch.
        """
        arrays = self.copies.arrays()
        start = sum(self.counts[:number])
        points = slice(start, start + self.counts[number])
        point_arrays = zip(self.point_names, arrays, strict=False)
        scan_arrays = zip(self.scan_names, arrays[len(self.point_names) :], strict=True)
        results = {name: array[points].copy() for name, array in point_arrays}
        results |= {name: array[number].copy() for name, array in scan_arrays}
        return DeviceLabels(**results)
