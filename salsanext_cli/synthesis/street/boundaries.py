# SPDX-License-Identifier: MIT
"""Fences, walls, hedges and undergrowth that separate lots from the street and each other."""

from functools import partial

from salsanext_cli.synthesis.street.builder import Builder, Maker
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things import fences, vegetation

LOW_M = (0.3, 1.1)
HIGH_M = (1.1, 2.1)
"""Heights of low and of high walls and solid fences."""
Span = tuple[float, float]


def boundary(builder: Builder) -> Maker:
    """Return a maker of pieces of a hedge, a fence or a wall."""
    if builder.chance(0.4):
        return hedge(builder)
    kind = str(builder.rng.choice(fences.FENCES))
    if kind in fences.SOLID:
        heights = HIGH_M if builder.chance(0.4) else LOW_M
    else:
        heights = (1.1, 2.2) if builder.chance(0.25) else (0.5, 1.1)
    height = builder.between(*heights)
    shade = builder.between(0.7, 1.5)
    return partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)


def hedge(builder: Builder) -> Maker:
    """Return a maker of pieces of a hedge, low or high, clipped or ragged."""
    low = builder.chance(0.6)
    heights = (0.4, 1.2) if low else (0.7, 3.2)
    height = builder.between(*heights)
    depth = builder.between(0.4, 1.0 if low else 1.5)
    clipped = builder.chance(0.75 if low else 0.5)
    roughness = (0.003, vegetation.CLIPPED_M) if clipped else (0.03, 0.2)
    ragged = builder.between(*roughness)
    return partial(vegetation.hedge, builder.rng, height=height, depth=depth, ragged=ragged)


def undergrowth(builder: Builder, heights: Span, depths: Span) -> Maker:
    """Return a maker of pieces of undergrowth; heights and depths are bounds in metres."""
    height = builder.between(*heights)
    depth = builder.between(*depths)
    return partial(vegetation.thicket, builder.rng, depth=depth, height=height)


def close(
    builder: Builder, side: Side, start: float, end: float, out: float, open_chance: float = 0.1
) -> None:
    """Fence a lot off towards the street, perhaps with bushes, or leave it open."""
    if builder.chance(open_chance) or end - start < 0.5:
        return
    builder.put_line(boundary(builder), side, start, end, out)
    if builder.chance(0.6):
        bushes = undergrowth(builder, (1.2, 4.0), (0.8, 1.6))
        builder.put_line(bushes, side, start, end, out + builder.between(0.3, 0.9))
