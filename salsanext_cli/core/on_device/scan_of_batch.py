# SPDX-License-Identifier: MIT
"""Scan whose results are on their way from a device."""

from dataclasses import dataclass

from salsanext_cli.core.on_device.device_labels import DeviceLabels
from salsanext_cli.core.on_device.labelled_batch import LabelledBatch


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanOfBatch:
    """Scan of a batch whose results are on their way from a device.

    Attributes
    ----------
    batch : LabelledBatch
        Results of all scans of the batch.
    number : int
        Number of the scan in the batch.
    """

    batch: LabelledBatch
    number: int

    def labels(self) -> DeviceLabels:
        """Wait for the results of the scan, and return them."""
        return self.batch.labels_of(self.number)
