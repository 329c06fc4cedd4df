# SPDX-License-Identifier: MIT
"""A convolution and what comes after it as one step, for a CPU and float32.

The layers after the convolution are computed while a part of the image is in the processor's cache.
Every part is computed by one thread, and which parts there are depends on the sizes alone, so the
bits of the result do not depend on the number of threads, nor on what else is in the batch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.inference import winograd
from salsanext_cli.inference.parallel_for import parallel_for, scratch
from salsanext_cli.records import Float

PIXELS = (128, 1024)
"""Fewest and most pixels of a part of a 1×1 convolution."""
TILES = (32, 128)
"""Fewest and most tiles of a part of a 3×3 convolution: less, and kernels are read too often; more,
and the products leave the cache."""
PARTS = 8
"""Parts that an image is cut into if they are neither too small nor too large."""


@dataclass(frozen=True, slots=True, eq=False)
class Epilogue:
    """Arithmetic after a convolution: ``scale · leaky(y + bias) + shift``, a value per channel.

    Attributes
    ----------
    bias, scale, shift : (O,) float32
        Of the convolution; of the batch norm, if it comes last.
    slope : float
        Of the LeakyReLU; 1 for none.
    """

    bias: Float
    scale: Float
    shift: Float
    slope: np.float32

    @property
    def is_bias(self) -> bool:
        """Say whether nothing but a bias comes after the convolution."""
        return bool(self.slope == 1 and (self.scale == 1).all() and (self.shift == 0).all())

    @property
    def numbers(self) -> tuple[Any, ...]:
        """Return what the kernels take."""
        return self.bias, self.scale, self.shift, self.slope


class Convolution3x3(nn.Module):
    """A 3×3 convolution that keeps the size, and what comes after it.

    Parameters
    ----------
    kernels : (O, I, 3, 3) float32
        I and O are multiples of 16.
    dilation : int
        Padding is the same.
    ending : Ending
        What comes after it.
    """

    def __init__(self, kernels: Tensor, dilation: int, ending: Epilogue) -> None:
        super().__init__()
        self.kernels = winograd.transformed(kernels)
        self.dilation = dilation
        self.numbers = ending.numbers

    def forward(self, x: Tensor, target: Tensor | None = None) -> Tensor:
        """Map (B, I, H, W) to (B, O, H, W), channels last; into `target` if there is one.

        Both may be some of the channels of larger tensors.
        """
        _, inputs, outputs = self.kernels.shape
        before = _channels_last(x)
        batch, height, width, _ = before.shape
        if target is None:
            target = before.new_empty(batch, height, width, outputs).permute(0, 3, 1, 2)
        after = target.permute(0, 2, 3, 1)
        tiling = winograd.Tiling(height, width, self.dilation)
        size = _part(tiling.count, TILES)
        parts = -(-tiling.count // size)

        def compute(part: int) -> None:
            image, part = divmod(part, parts)
            first = part * size
            count = min(size, tiling.count - first)
            v = scratch("v", winograd.PLACES * count * inputs)
            m = scratch("m", winograd.PLACES * count * outputs)
            numbers = (*tiling.numbers, first, count)
            winograd.gather(*_pixels(before[image]), inputs, *numbers, v.numpy())
            rows = v.view(winograd.PLACES, count, inputs)
            torch.bmm(rows, self.kernels, out=m.view(winograd.PLACES, count, outputs))
            winograd.scatter(m.numpy(), *_pixels(after[image]), outputs, *numbers, *self.numbers)

        parallel_for(compute, batch * parts)
        return target


class Convolution1x1(nn.Module):
    """A 1×1 convolution, and what comes after it.

    Parameters
    ----------
    kernels : (O, I, 1, 1) float32
        O is a multiple of 16, unless nothing but a bias comes after it.
    ending : Ending
        What comes after it.
    """

    def __init__(self, kernels: Tensor, ending: Epilogue) -> None:
        super().__init__()
        self.kernels = kernels.flatten(1).t().contiguous()
        self.numbers = ending.numbers
        self.bias = torch.from_numpy(ending.bias) if ending.is_bias else None

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, I, H, W) to (B, O, H, W), channels last."""
        inputs, outputs = self.kernels.shape
        batch, _, height, width = x.shape
        before = x.permute(0, 2, 3, 1).reshape(batch, height * width, inputs)
        after = before.new_empty(batch, height * width, outputs)
        size = _part(height * width, PIXELS)
        parts = -(-height * width // size)

        def compute(part: int) -> None:
            image, part = divmod(part, parts)
            pixels = slice(part * size, (part + 1) * size)
            rows, target = before[image, pixels], after[image, pixels]
            if self.bias is not None:
                torch.addmm(self.bias, rows, self.kernels, out=target)
                return
            torch.mm(rows, self.kernels, out=target)
            winograd.finish(target.view(-1).numpy(), outputs, *self.numbers)

        parallel_for(compute, batch * parts)
        return after.view(batch, height, width, outputs).permute(0, 3, 1, 2)


class Stack(nn.Module):
    """A `blocks.DilatedStack`, each part of which writes beside the one before it."""

    def __init__(
        self,
        narrow: Convolution3x3,
        middle: Convolution3x3,
        wide: Convolution3x3,
        fuse: Convolution1x1,
    ) -> None:
        super().__init__()
        self.parts = nn.ModuleList((narrow, middle, wide))
        self.fuse = fuse

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, I, H, W) to (B, O, H, W), channels last."""
        batch, _, height, width = x.shape
        inputs = self.fuse.kernels.shape[0]
        joined = x.new_empty(batch, height, width, inputs).permute(0, 3, 1, 2)
        for part, place in zip(self.parts, joined.chunk(len(self.parts), dim=1), strict=True):
            x = part(x, place)
        fused: Tensor = self.fuse(joined)
        return fused


class OneThread(nn.Module):
    """A layer as it is, each image of the batch computed by one thread."""

    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, x: Tensor) -> Tensor:
        """Map what the layer maps."""
        found: list[Tensor] = [x] * len(x)

        def compute(image: int) -> None:
            found[image] = self.layer(x[image : image + 1])

        parallel_for(compute, len(x))
        return torch.cat(found)


def _part(count: int, limits: tuple[int, int]) -> int:
    """Return how many of so many tiles or pixels are a part."""
    fewest, most = limits
    return min(most, max(fewest, -(-count // PARTS)))


def _channels_last(x: Tensor) -> Tensor:
    """Return (B, C, H, W) as (B, H, W, C) whose pixels lie evenly, copied only if they do not."""
    pixels = x.permute(0, 2, 3, 1)
    _, row, pitch, channel = pixels.stride()
    return pixels if channel == 1 and row == pitch * pixels.shape[2] else pixels.contiguous()


def _pixels(image: Tensor) -> tuple[Float, int]:
    """Return the flat array behind (H, W, C), and how far apart its pixels begin."""
    height, width, channels = image.shape
    pitch = image.stride(1)
    flat: Float = image.as_strided(((height * width - 1) * pitch + channels,), (1,)).numpy()
    return flat, pitch
