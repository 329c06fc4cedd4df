# SPDX-License-Identifier: MIT
"""Quantisation of the inputs of layers, with which a network computes in 8-bit integers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.records import Float

LEVELS = 256  # Of an unsigned byte
MAX_SHIFT = 15  # One hexadecimal digit
MIN_STEP = 1e-30  # With the largest shift it is still a normal float32


@dataclass(frozen=True, slots=True)
class Int8Input:
    """Quantisation of the input of a layer: x = step · 2^-shift · (q - zero), q from 0 to 255."""

    zero: int
    step: float
    shifts: str  # A hexadecimal digit per channel: channels of small values have small steps

    def __post_init__(self) -> None:
        digits = self.shifts and {*self.shifts} <= {*"0123456789abcdef"}
        if not (digits and 0 <= self.zero < LEVELS and 0 < self.step < math.inf):
            raise ValueError("no quantisation of an input")

    @property
    def steps(self) -> Float:
        """Steps of the channels, (C,) float32."""
        shifts = np.array([int(digit, 16) for digit in self.shifts])
        return np.ldexp(np.float32(self.step), -shifts)

    @classmethod
    def from_ranges(cls, lowest: Float, highest: Float) -> Int8Input:
        """Return the quantisation for channels with these ranges, (C,) each.

        Channels of smaller values have smaller steps, by the square root: the weights of a channel
        become smaller as its step does, and lose digits.
        """
        largest = np.maximum(np.maximum(-lowest, highest), np.finfo(np.float32).tiny)
        octaves = np.log2(largest)
        shifts = ((octaves.max() - octaves) / 2).astype(int).clip(0, MAX_SHIFT)
        low = min(float(np.ldexp(lowest, shifts).min()), 0.0)
        high = max(float(np.ldexp(highest, shifts).max()), 0.0)
        zero = round((LEVELS - 1) * -low / (high - low)) if low < high else 0
        zero = min(max(zero, int(low < 0)), LEVELS - 1 - int(high > 0))
        step = max(-low / max(zero, 1), high / max(LEVELS - 1 - zero, 1), MIN_STEP)
        return cls(zero, float(f"{step:.4g}"), "".join(f"{shift:x}" for shift in shifts))
