# SPDX-License-Identifier: MIT
"""What the validation of a training keeps of a scan."""

from dataclasses import dataclass

from torch import Tensor

from salsanext_cli.core.measures.scores import Counts

MAX_VALIDATED_POINTS = 200_000  # Points of all scans that the temperature is fitted to


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ValidatedScan:
    """Confusion of a validated scan, and a sample of its points."""

    confusion: Counts  # (C, C)
    logits: Tensor  # (C, M) float32: of some points of scored classes
    truth: Tensor  # (M,) int64
    is_finite: bool  # Whether the logits of all pixels are


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ValidatedScans:
    """Confusion of the validated scans of all workers, and a sample of their points."""

    confusion: Counts  # (C, C)
    logits: Tensor  # (M, C) float32
    truth: Tensor  # (M,) int64
    infinite_scans: int  # Number of scans with logits that are not finite


def sample_interval(usable: int, scans: int) -> int:
    """Return the interval of the points that are kept of the usable ones of a scan.

    Parameters
    ----------
    usable : int
        Number of usable points of the scan.
    scans : int
        Number of scans of the validation.
    """
    return max(1, usable * scans // MAX_VALIDATED_POINTS)
