# SPDX-License-Identifier: MIT
"""3×3 convolutions with a quarter of the multiplications: Winograd's F(4×4, 3×3).

A tile of 4×4 outputs needs 6×6 inputs. Both are changed to coordinates in which the convolution is
a product of numbers, 36 of them instead of 144: V = Bᵀ d B of the inputs, U = G g Gᵀ of the kernel,
and Aᵀ (U ⊙ V) A is the output (Lavin and Gray, arXiv 1509.09308). Summed over the channels, the
products are 36 products of matrices, tiles × inputs by inputs × outputs.

A convolution of dilation 2 is four of dilation 1, each on every other row and column.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.inference.lanes import LANES, leaky, load, splat, store
from salsanext_cli.kernels import compiled
from salsanext_cli.records import Float

TILE, SPAN = 4, 6
"""Side of a tile of outputs, and of the inputs that it needs."""
PLACES = SPAN**2
KERNEL_TRANSFORM = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
"""G: a polynomial of the kernel's three numbers at 0, 1, -1, 2, -2 and infinity, scaled."""


def transformed(kernels: Tensor) -> Tensor:
    """Return U: kernels (O, I, 3, 3) as 36 matrices, (36, I, O) float32."""
    matrix = torch.tensor(KERNEL_TRANSFORM, dtype=torch.float64)
    found = torch.einsum("ay,bx,oiyx->abio", matrix, matrix, kernels.double())
    return found.reshape(PLACES, *found.shape[2:]).float().contiguous()


@dataclass(frozen=True, slots=True)
class Tiling:
    """Cut of an image into tiles: of each part of every d-th row and column, row by row."""

    height: int
    width: int
    dilation: int

    @property
    def numbers(self) -> tuple[int, int, int, int, int]:
        """Return what the kernels take: height, width, dilation, rows and columns of tiles."""
        reach = TILE * self.dilation
        rows, columns = -(-self.height // reach), -(-self.width // reach)
        return self.height, self.width, self.dilation, rows, columns

    @property
    def count(self) -> int:
        """Return the number of tiles."""
        *_, rows, columns = self.numbers
        return rows * columns * self.dilation**2


@compiled
def corner(tile: int, dilation: int, rows: int, columns: int) -> tuple[int, int]:
    """Return row and column of a tile's first output."""
    part, rest = divmod(tile, rows * columns)
    row, column = divmod(rest, columns)
    down, right = divmod(part, dilation)
    return TILE * row * dilation + down, TILE * column * dilation + right


@compiled
def to_products(x: Float, i: int, step: int, y: Float, o: int, stride: int) -> None:
    """Write Bᵀ d of six rows of lanes ``x[i], x[i + step], …`` to ``y[o], y[o + stride], …``."""
    two, four, five = splat(np.float32(2)), splat(np.float32(4)), splat(np.float32(5))
    a, b, c = load(x, i), load(x, i + step), load(x, i + 2 * step)
    d, e, f = load(x, i + 3 * step), load(x, i + 4 * step), load(x, i + 5 * step)
    even, odd = e - four * c, d - four * b
    near, far = e - c, two * (d - b)
    store(y, o, four * a - five * c + e)
    store(y, o + stride, even + odd)
    store(y, o + 2 * stride, even - odd)
    store(y, o + 3 * stride, near + far)
    store(y, o + 4 * stride, near - far)
    store(y, o + 5 * stride, four * b - five * d + f)


@compiled
def from_products(x: Float, i: int, step: int, y: Float, o: int, stride: int) -> None:
    """Write Aᵀ m of six rows of lanes to four rows."""
    two, four, eight = splat(np.float32(2)), splat(np.float32(4)), splat(np.float32(8))
    a, b, c = load(x, i), load(x, i + step), load(x, i + 2 * step)
    d, e, f = load(x, i + 3 * step), load(x, i + 4 * step), load(x, i + 5 * step)
    near, near_odd, far, far_odd = b + c, b - c, d + e, d - e
    store(y, o, a + near + far)
    store(y, o + stride, near_odd + two * far_odd)
    store(y, o + 2 * stride, near + four * far)
    store(y, o + 3 * stride, near_odd + eight * far_odd + f)


@compiled
def gather(
    image: Float,
    pitch: int,
    channels: int,
    height: int,
    width: int,
    dilation: int,
    rows: int,
    columns: int,
    first: int,
    count: int,
    products: Float,
) -> None:
    """Write V of `count` tiles, (36, count, channels), from an image (height, width, channels).

    Beyond the image are zeros. All arrays are flat; pixels begin `pitch` numbers apart, and the
    channels are a multiple of 16.
    """
    window = np.empty(PLACES * LANES, np.float32)
    half = np.empty(PLACES * LANES, np.float32)
    line = SPAN * LANES
    for n in range(count):
        top, left = corner(first + n, dilation, rows, columns)
        top, left = top - dilation, left - dilation
        bottom, right = top + (SPAN - 1) * dilation, left + (SPAN - 1) * dilation
        inside = (top >= 0) & (left >= 0) & (bottom < height) & (right < width)
        for block in range(0, channels, LANES):
            for x in range(SPAN):
                if inside:
                    place = (top * width + left + x * dilation) * pitch + block
                    step = dilation * width * pitch
                    to_products(image, place, step, half, x * LANES, line)
                    continue
                column = left + x * dilation
                for y in range(SPAN):
                    row, place = top + y * dilation, (y * SPAN + x) * LANES
                    if (row >= 0) & (row < height) & (column >= 0) & (column < width):
                        here = load(image, (row * width + column) * pitch + block)
                        store(window, place, here)
                    else:
                        store(window, place, splat(np.float32(0)))
                to_products(window, x * LANES, line, half, x * LANES, line)
            for y in range(SPAN):
                place = (y * SPAN * count + n) * channels + block
                to_products(half, y * line, LANES, products, place, count * channels)


@compiled
def scatter(
    products: Float,
    image: Float,
    pitch: int,
    channels: int,
    height: int,
    width: int,
    dilation: int,
    rows: int,
    columns: int,
    first: int,
    count: int,
    bias: Float,
    scale: Float,
    shift: Float,
    slope: np.float32,
) -> None:
    """Write the outputs of `count` tiles from their products, (36, count, channels).

    An output y becomes ``scale · leaky(y + bias) + shift``, each of a value per channel.
    """
    half = np.empty(TILE * SPAN * LANES, np.float32)
    outputs = np.empty(TILE * LANES, np.float32)
    line = SPAN * LANES
    for n in range(count):
        top, left = corner(first + n, dilation, rows, columns)
        for block in range(0, channels, LANES):
            for x in range(SPAN):
                place = (x * count + n) * channels + block
                step = SPAN * count * channels
                from_products(products, place, step, half, x * LANES, line)
            for y in range(TILE):
                row = top + y * dilation
                if row >= height:
                    break
                from_products(half, y * line, LANES, outputs, 0, LANES)
                for x in range(TILE):
                    column = left + x * dilation
                    if column < width:
                        raw = load(outputs, x * LANES) + load(bias, block)
                        bent = leaky(raw, splat(slope))
                        done = bent * load(scale, block) + load(shift, block)
                        store(image, (row * width + column) * pitch + block, done)


@compiled
def finish(
    rows: Float, channels: int, bias: Float, scale: Float, shift: Float, slope: np.float32
) -> None:
    """Turn every y of flat rows of channels into ``scale · leaky(y + bias) + shift``."""
    for start in range(0, len(rows), channels):
        for block in range(0, channels, LANES):
            raw = load(rows, start + block) + load(bias, block)
            bent = leaky(raw, splat(slope))
            store(rows, start + block, bent * load(scale, block) + load(shift, block))
