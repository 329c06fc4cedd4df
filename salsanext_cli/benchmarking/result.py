# SPDX-License-Identifier: MIT
"""What a benchmark finds: seconds and memory of each part, side by side."""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from salsanext_cli.benchmarking.ceiling import Ceiling
from salsanext_cli.benchmarking.machine import Machine


@dataclass(frozen=True, slots=True)
class Turn:
    """One measurement of one side.

    Attributes
    ----------
    seconds : float
        Of one scan; of the processor where a command is measured that does nothing.
    peak, device_peak : int, optional
        Most memory of the process and of the GPU meanwhile, bytes; None where nobody says.
    """

    seconds: float
    peak: int | None = None
    device_peak: int | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """One part, measured in turns.

    Attributes
    ----------
    part : str
        One of `benchmark.PARTS`.
    baseline, product : tuple of Turn
        The turns of each side in pairs, on the same scan; the baseline's are missing where it has
        no such part.
    floor : float, optional
        Seconds below which no program gets on this machine, by its measured ceilings.
    """

    part: str
    baseline: tuple[Turn, ...]
    product: tuple[Turn, ...]
    floor: float | None = None

    @property
    def ratios(self) -> list[float]:
        """How many times as fast as the baseline the product was, turn by turn."""
        pairs = zip(self.baseline, self.product, strict=bool(self.baseline))
        return [plain.seconds / ours.seconds for plain, ours in pairs]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: each turn, medians, the ratio's spread, the share of the ceiling."""
        ratios = self.ratios
        spread = (
            {
                "median": statistics.median(ratios),
                "lowest": min(ratios),
                "highest": max(ratios),
            }
            if ratios
            else None
        )
        product = _summary(self.product)
        return {
            "part": self.part,
            "baseline": _summary(self.baseline) if self.baseline else None,
            "product": product,
            "ratio": spread,
            "floor": self.floor,
            "share_of_ceiling": None if self.floor is None else self.floor / product["median"],
        }


def _summary(turns: tuple[Turn, ...]) -> dict[str, Any]:
    seconds = [turn.seconds for turn in turns]
    return {
        "median": statistics.median(seconds),
        "seconds": seconds,
        "peak_bytes": _most(turn.peak for turn in turns),
        "device_peak_bytes": _most(turn.device_peak for turn in turns),
    }


def _most(peaks: Iterable[int | None]) -> int | None:
    return max((peak for peak in peaks if peak is not None), default=None)


@dataclass(frozen=True, slots=True)
class Benchmark:
    """All parts, and what they were measured on.

    Attributes
    ----------
    machine : Machine
        What computed.
    ceiling : Ceiling
        The best that was measured of it.
    settings : dict
        Sensor, scans, points, rounds and passes.
    parts : tuple of Measured
        In the order of `benchmark.PARTS`.
    """

    machine: Machine
    ceiling: Ceiling
    settings: dict[str, Any]
    parts: tuple[Measured, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "machine": asdict(self.machine),
            "ceiling": asdict(self.ceiling),
            "settings": self.settings,
            "parts": [part.to_dict() for part in self.parts],
        }
