# SPDX-License-Identifier: MIT
"""Scans that one part of the weights is fitted to, and the part that comes of it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.results.layout import ScanFile


@dataclass(frozen=True, slots=True, eq=False)
class TuningScans:
    """Scans that a part of the weights is fitted to."""

    source: Path
    files: list[ScanFile]
    space: LabelSpace  # Of the labels, if they are read; else that of the network
    network: Network  # Fitted to the sensor of the scans
    progress: Callable[[int, int], object] | None = None  # Called after each step

    def each(self) -> Iterator[ScanFile]:
        """Yield each scan, and report when the next one is asked for."""
        for number, file in enumerate(self.files, start=1):
            yield file
            if self.progress:
                self.progress(number, len(self.files))


@dataclass(frozen=True, slots=True, eq=False)
class Tuned:
    """Part of the weights that was fitted."""

    card: WeightsCard  # Card of the new weights
    report: dict[str, Any]  # Plain data
    tensors: Mapping[str, Tensor] = field(default_factory=dict)  # Others than in the old weights
