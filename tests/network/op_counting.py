# SPDX-License-Identifier: MIT
"""Parameters and multiply-accumulates of the papers' networks, by arithmetic instead of torch.

A part is (parameters, multiply-accumulates of its convolutions). Written from the papers' text and
figures, level by level; nothing is shared with the networks.
"""

from itertools import pairwise

PIXELS = 64 * 2048


def total(*parts):
    """Return the sum of parts."""
    return tuple(map(sum, zip(*parts, strict=True)))


def conv(inputs, outputs, cells, pixels, bias=True):
    """Count a convolution with so many cells of a window, at so many pixels."""
    weights = inputs * outputs * cells
    return weights + outputs * bias, weights * pixels


def norm(channels):
    """Count a batch norm."""
    return 2 * channels, 0


def units(inputs, outputs, count, pixels):
    """Count 3×3 convolutions in a row, each with batch norm."""
    first = conv(inputs, outputs, 9, pixels)
    return total(first, *(count - 1) * [conv(outputs, outputs, 9, pixels)], norm(count * outputs))


def dilated(inputs, outputs, pixels):
    """Count a stack of 3×3, 3×3 and 2×2, fused."""
    windows = (conv(inputs, outputs, 9, pixels), conv(outputs, outputs, 9, pixels))
    wide, fuse = conv(outputs, outputs, 4, pixels), conv(3 * outputs, outputs, 1, pixels)
    return total(*windows, wide, fuse, norm(4 * outputs))


def residual(inputs, outputs, pixels):
    """Count a ResNet block of SalsaNet."""
    return total(conv(inputs, outputs, 1, pixels), units(inputs, outputs, 2, pixels))


def context(inputs, plain=False):
    """Count a context block of 32 channels; the plain one begins with the input."""
    body = conv(inputs if plain else 32, 32, 9, PIXELS)
    return total(conv(inputs, 32, 1, PIXELS), body, conv(32, 32, 9, PIXELS), norm(64))


CONTEXT = total(context(5), context(32), context(32))
HEAD = conv(32, 20, 1, PIXELS)


def transposed(inputs, outputs, cells, pixels):
    """Count a transposed convolution with batch norm, over the pixels that it begins with."""
    return total(conv(inputs, outputs, cells, pixels // 4), norm(outputs))


def salsanet(inputs, widths, raised, strided):
    """Count SalsaNet's encoder and decoder."""
    parts = []
    for level, width in enumerate(widths):
        parts.append(residual(inputs, width, PIXELS >> 2 * level))
        inputs = width
    if strided:
        pooled = enumerate(widths[:-1], 1)
        parts += [conv(width, width, 9, PIXELS >> 2 * level) for level, width in pooled]
    for level, width in reversed(list(enumerate(reversed(raised)))):
        pixels = PIXELS >> 2 * level
        parts += [transposed(inputs, width, 9, pixels), units(width, width, 3, pixels)]
        inputs = width
    return total(*parts, HEAD)


def salsanext_encoder():
    """Count the five residual dilated blocks."""
    widths = (32, 64, 128, 256, 256, 256)
    blocks = []
    for level, (inputs, outputs) in enumerate(pairwise(widths)):
        pixels = PIXELS >> 2 * level
        blocks += [conv(inputs, outputs, 1, pixels), dilated(inputs, outputs, pixels)]
    return total(CONTEXT, *blocks)


def shuffled():
    """Count SalsaNext's decoder."""
    joins = ((256 // 4 + 256, 128, 3), (128 // 4 + 256, 128, 2), (128 // 4 + 128, 64, 1))
    joins += ((64 // 4 + 64, 32, 0),)
    return total(*(dilated(inputs, width, PIXELS >> 2 * level) for inputs, width, level in joins))


def raised_by_transposing():
    """Count a decoder of 2×2 transposed convolutions, beside the skip connections."""
    parts = []
    for inputs, skip, width, level in (
        (256, 256, 256, 3),
        (256, 256, 128, 2),
        (128, 128, 64, 1),
        (64, 64, 32, 0),
    ):
        pixels = PIXELS >> 2 * level
        parts += [transposed(inputs, inputs, 4, pixels), dilated(inputs + skip, width, pixels)]
    return total(*parts)


def rangenet():
    """Count the stem, five stages of 1, 2, 8, 8 and 4 blocks, five levels up and the head."""

    def block(channels, inner, pixels):
        narrow = conv(channels, inner, 1, pixels, bias=False)
        return total(narrow, conv(inner, channels, 9, pixels, bias=False), norm(channels + inner))

    parts = [conv(5, 32, 9, PIXELS, bias=False), norm(32)]
    for level, depth in enumerate((1, 2, 8, 8, 4), 1):
        outputs, pixels = 32 << level, PIXELS >> level
        parts += [conv(outputs // 2, outputs, 9, pixels, bias=False), norm(outputs)]
        parts += depth * [block(outputs, outputs // 2, pixels)]
        parts += [conv(outputs, outputs // 2, 4, pixels), norm(outputs // 2)]
        parts += [block(outputs // 2, outputs, 2 * pixels)]
    return total(*parts, conv(32, 20, 9, PIXELS))


SALSANET = ((32, 64, 128, 256, 256), (256, 128, 64, 32))
DEEPER = ((32, 64, 128, 256, 512, 512), (512, 256, 128, 64, 32))
FIRST_CONTEXT = context(5, plain=True)
SALSANEXT = total(salsanext_encoder(), shuffled(), HEAD)
V1 = total(FIRST_CONTEXT, salsanet(32, *DEEPER, strided=False))
V1_STRIDED = total(FIRST_CONTEXT, salsanet(32, *DEEPER, strided=True))
WITH_CONTEXT = total(CONTEXT, salsanet(32, *SALSANET, strided=True))

COUNTS = {
    "salsanext": SALSANEXT,
    "salsanext-v1": V1,
    "rangenet53": rangenet(),
    "salsanet": salsanet(5, *SALSANET, strided=True),
    "salsanet-context": WITH_CONTEXT,
    "salsanet-dropout": WITH_CONTEXT,
    "salsanet-pooling": total(CONTEXT, salsanet(32, *SALSANET, strided=False)),
    "salsanet-dilated": total(salsanext_encoder(), raised_by_transposing(), HEAD),
    "salsanet-shuffle": SALSANEXT,
    "salsanext-v1-layers": salsanet(5, *DEEPER, strided=True),
    "salsanext-v1-context": V1_STRIDED,
    "salsanext-v1-dropout": V1_STRIDED,
    "salsanext-v1-pooling": V1,
}
