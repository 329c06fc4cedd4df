# SPDX-License-Identifier: MIT
"""How much of a range image a pixel's logits depend on, followed through the network.

As with the moments, the network is not written a second time: `Reach` stands in for a tensor, and
every rule says what a function of the network does to the windows that its values depend on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.tensor_like import TensorLike

SIDE = 2048
"""Pixels of the square image in whose middle is measured; no edge may be in sight."""

Spans = npt.NDArray[np.int64]
"""(2, N): the first and the last line of the image that each of N lines depends on."""


def receptive_field(network: SegmentationNetwork) -> tuple[int, int]:
    """Return height and width of the window of the image that a pixel's logits depend on.

    The largest, where it differs between the pixels of a cell of the coarsest level.
    """
    image: Any = Reach.of(SIDE, SIDE)
    reach: Any = network.rest(*network.trunk(image))
    middle = [slice(SIDE // 2, SIDE // 2 + step) for step in network.stride]
    spans = (axis[:, part] for axis, part in zip((reach.rows, reach.columns), middle, strict=True))
    height, width = (int((last - first).max()) + 1 for first, last in spans)
    return height, width


@dataclass(frozen=True, slots=True, eq=False)
class Reach(TensorLike):
    """What of the image the values of a feature map depend on.

    Attributes
    ----------
    rows, columns : (2, H) and (2, W) int64
        First and last row of the image for each row of the map, and the same of columns. All
        channels reach as far, as they do where no weight is 0.
    """

    VIEW: ClassVar[str] = "reach"

    rows: Spans
    columns: Spans

    @classmethod
    def of(cls, height: int, width: int) -> Self:
        """Return that of an image, each line of which depends on itself."""
        return cls(*(np.stack([np.arange(n)] * 2) for n in (height, width)))

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.rows.shape[1], self.columns.shape[1]

    def dim(self) -> int:
        """Return the number of dimensions of what this stands for."""
        return 4

    def __add__(self, other: Reach) -> Reach:
        return Reach(_hull(self.rows, other.rows), _hull(self.columns, other.columns))


def _hull(one: Spans, other: Spans) -> Spans:
    return np.stack([np.minimum(one[0], other[0]), np.maximum(one[1], other[1])])


def _windows(x: Spans, size: int, stride: int, padding: int, dilation: int) -> Spans:
    """Return the spans of windows over lines; what lies outside of the image depends on nothing."""
    reach = dilation * (size - 1) + 1
    starts = np.arange(0, x.shape[1] + 2 * padding - reach + 1, stride) - padding
    taps = starts[:, None] + dilation * np.arange(size)
    return _span(x, taps, (taps >= 0) & (taps < x.shape[1]))


def _raised(x: Spans, size: int, stride: int, padding: int, output_padding: int) -> Spans:
    """Return the spans of what a transposed convolution makes of lines."""
    count = (x.shape[1] - 1) * stride - 2 * padding + size + output_padding
    steps = np.arange(count)[:, None] + padding - np.arange(size)
    taps = steps // stride
    return _span(x, taps, (steps % stride == 0) & (taps >= 0) & (taps < x.shape[1]))


def _span(x: Spans, taps: Spans, there: npt.NDArray[np.bool_]) -> Spans:
    """Return the spans from the first to the last of the taps that are there."""
    taps = taps.clip(0, x.shape[1] - 1)
    first = np.where(there, x[0][taps], np.iinfo(np.int64).max).min(axis=1)
    return np.stack([first, np.where(there, x[1][taps], -1).max(axis=1)])


def _both(
    rule: Callable[..., Spans], x: Reach, window: Sequence[int], *geometry: int | Sequence[int]
) -> Reach:
    """Apply a rule of lines to rows and columns, numbers given once or for each."""
    pairs = [(g, g) if isinstance(g, int) else g for g in (window, *geometry)]
    return Reach(*(rule(x, *g) for x, *g in zip((x.rows, x.columns), *pairs, strict=True)))


def _conv2d(
    x: Reach, weight: Tensor, bias: Any, stride: Any, padding: Any, dilation: Any, groups: int
) -> Reach:
    return _both(_windows, x, weight.shape[2:], stride, padding, dilation)


def _conv_transpose2d(
    x: Reach, weight: Tensor, bias: Any, stride: Any, padding: Any, more: Any, *_: Any
) -> Reach:
    return _both(_raised, x, weight.shape[2:], stride, padding, more)


def _avg_pool2d(x: Reach, kernel: int, stride: int, padding: int, *_: Any) -> Reach:
    return _both(_windows, x, (kernel, kernel), stride, padding, 1)


def _pixel_shuffle(x: Reach, factor: int) -> Reach:
    return Reach(x.rows.repeat(factor, axis=1), x.columns.repeat(factor, axis=1))


def _pad(x: Reach, pad: Sequence[int], mode: str, value: Any = None) -> Reach:
    if mode != "replicate":
        raise NotImplementedError(f"padding of mode {mode}")
    left, right, top, bottom = pad

    def repeated(lines: Spans, before: int, after: int) -> Spans:
        return np.pad(lines, ((0, 0), (before, after)), mode="edge")

    return Reach(repeated(x.rows, top, bottom), repeated(x.columns, left, right))


def _concatenate(parts: Sequence[Reach], dim: int) -> Reach:
    whole = parts[0]
    for part in parts[1:]:
        whole = whole + part
    return whole


def _same(x: Reach, *_: Any, **__: Any) -> Reach:
    return x


Reach.RULES = {
    F.conv2d: _conv2d,
    F.conv_transpose2d: _conv_transpose2d,
    F.avg_pool2d: _avg_pool2d,
    F.pad: _pad,
    F.pixel_shuffle: _pixel_shuffle,
    F.batch_norm: _same,
    F.leaky_relu: _same,
    F.dropout2d: _same,
    torch.cat: _concatenate,
}
