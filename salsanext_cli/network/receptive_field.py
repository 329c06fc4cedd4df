# SPDX-License-Identifier: MIT
"""Receptive field: the window of a range image that a pixel's logits depend on.

As with the moments, the network is not written a second time: `Dependence` stands in for a tensor,
and every rule says what a function of the network does to the windows that its values depend on.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.tensor_like import TensorLike

SIDE = 2048
"""Pixels of the square image in whose middle is measured; no edge may be in sight."""


def receptive_field(network: SegmentationNetwork) -> tuple[int, int]:
    """Return height and width of the window of the image that a pixel's logits depend on.

    The largest, where it differs between the pixels of a cell of the coarsest level.
    """
    image: Any = Dependence.of(SIDE, SIDE)
    logits: Any = network.rest(*network.trunk(image))
    middle = [slice(SIDE // 2, SIDE // 2 + step) for step in network.stride]
    axes = zip((logits.rows, logits.columns), middle, strict=True)
    height, width = (int(lines[:, part].sum(dim=0).max()) + 1 for lines, part in axes)
    return height, width


@dataclass(frozen=True, slots=True, eq=False)
class Dependence(TensorLike):
    """What of the image the values of a feature map depend on.

    All channels depend on as much, as they do where no weight is 0.

    Attributes
    ----------
    rows, columns : (2, H) and (2, W) float32 Tensor
        For each row of the map the first row of the image, negated, and the last, so that both are
        maxima; -inf if it depends on none. The same of columns.
    """

    VIEW: ClassVar[str] = "receptive field"

    rows: Tensor
    columns: Tensor

    @classmethod
    def of(cls, height: int, width: int) -> Self:
        """Return that of an image, each line of which depends on itself."""
        return cls(
            *(torch.stack([-torch.arange(n), torch.arange(n)]).float() for n in (height, width))
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.rows.shape[1], self.columns.shape[1]

    def dim(self) -> int:
        """Return the number of dimensions of what this stands for."""
        return 4

    def __add__(self, other: Dependence) -> Dependence:
        return Dependence(self.rows.maximum(other.rows), self.columns.maximum(other.columns))


def _windows(lines: Tensor, size: int, stride: int, padding: int, dilation: int) -> Tensor:
    padded = F.pad(lines, (padding, padding), value=-math.inf)
    return F.max_pool1d(padded, size, stride, dilation=dilation)


def _transposed(lines: Tensor, size: int, stride: int, padding: int, more: int) -> Tensor:
    spread = lines.new_full((2, (lines.shape[1] - 1) * stride + 1), -math.inf)
    spread[:, ::stride] = lines
    margin = size - 1 - padding
    return F.max_pool1d(F.pad(spread, (margin, margin + more), value=-math.inf), size, 1)


def _both(
    rule: Callable[..., Tensor], x: Dependence, window: Sequence[int], *geometry: Any
) -> Dependence:
    """Apply a rule of lines to rows and columns, numbers given once or for each."""
    pairs = [(g, g) if isinstance(g, int) else g for g in (window, *geometry)]
    rows, columns = zip(*pairs, strict=True)
    return Dependence(rule(x.rows, *rows), rule(x.columns, *columns))


def _conv2d(
    x: Dependence, weight: Tensor, bias: Any, stride: Any, padding: Any, dilation: Any, groups: int
) -> Dependence:
    return _both(_windows, x, weight.shape[2:], stride, padding, dilation)


def _conv_transpose2d(
    x: Dependence, weight: Tensor, bias: Any, stride: Any, padding: Any, more: Any, *_: Any
) -> Dependence:
    return _both(_transposed, x, weight.shape[2:], stride, padding, more)


def _avg_pool2d(x: Dependence, kernel: int, stride: int, padding: int, *_: Any) -> Dependence:
    return _both(_windows, x, (kernel, kernel), stride, padding, 1)


def _pad(x: Dependence, pad: Sequence[int], mode: str, value: Any = None) -> Dependence:
    if mode != "replicate":
        raise NotImplementedError(f"padding of mode {mode}")
    left, right, top, bottom = pad
    return Dependence(F.pad(x.rows, (top, bottom), mode), F.pad(x.columns, (left, right), mode))


def _pixel_shuffle(x: Dependence, factor: int) -> Dependence:
    return Dependence(*(lines.repeat_interleave(factor, dim=1) for lines in (x.rows, x.columns)))


def _concatenate(parts: Sequence[Dependence], dim: int) -> Dependence:
    return reduce(operator.add, parts)


def _same(x: Dependence, *_: Any, **__: Any) -> Dependence:
    return x


Dependence.RULES = {
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
