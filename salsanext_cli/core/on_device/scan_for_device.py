# SPDX-License-Identifier: MIT
"""Scan that is ready for a device."""

from dataclasses import dataclass

from salsanext_cli.core.labelling import CheckedScan
from salsanext_cli.core.on_device.host_points import HostPoints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanForDevice:
    """Checked scan, and its points in memory that the device reads directly."""

    checked: CheckedScan
    points: HostPoints
