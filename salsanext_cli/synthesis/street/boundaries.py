# SPDX-License-Identifier: MIT
"""Fences, walls and hedges between the street and the lots, alike along one lot."""

from collections.abc import Callable
from functools import partial

from salsanext_cli.synthesis.mesh import Mesh
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things import fences, hedges, vegetation

Maker = Callable[[float], Mesh]
SOLID_M = 1.5
"""Largest height of a wall or boards around a lot; higher walls are rarely labelled fence."""


def boundary(builder: Builder) -> Maker:
    """Return a maker of pieces of a fence or a hedge."""
    return hedge(builder) if builder.chance(0.52) else fence(builder)


def hedge(builder: Builder) -> Maker:
    """Return a maker of pieces of a hedge: low or high, clipped or ragged."""
    height, depth = builder.between(0.7, 2.7), builder.between(0.5, 1.5)
    clipped = builder.chance(0.5)
    ragged = builder.between(0.003, 0.03) if clipped else builder.between(0.03, 0.2)
    return partial(hedges.hedge, builder.rng, height=height, depth=depth, ragged=ragged)


def fence(builder: Builder) -> Maker:
    """Return a maker of pieces of a fence or a wall."""
    kind = str(builder.rng.choice(fences.FENCES))
    if kind in ("wall", "boards"):
        height = builder.between(0.4, SOLID_M)
    else:
        height = builder.between(1.2, 2.4) if builder.chance(0.35) else builder.between(0.8, 1.3)
    shade = builder.between(0.7, 1.5)
    return partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)


def close(
    builder: Builder, side: Side, start: float, end: float, out: float, open_chance: float = 0.1
) -> None:
    """Close a lot off towards the street, perhaps with bushes behind, or leave it open."""
    if builder.chance(open_chance) or end - start < 0.5:
        return
    builder.put_line(boundary(builder), side, start, end, out)
    if builder.chance(0.6):
        height, depth = builder.between(1.2, 4.0), builder.between(0.8, 1.6)
        thicket(builder, side, start, end, out + builder.between(0.3, 0.9), height, depth)


def thicket(
    builder: Builder, side: Side, start: float, end: float, out: float, height: float, depth: float
) -> None:
    """Grow undergrowth from `start` to `end`, beginning `out` metres beyond the kerb."""
    piece = partial(vegetation.thicket, builder.rng, depth=depth, height=height)
    builder.put_line(piece, side, start, end, out)


def wall(builder: Builder, side: Side, start: float, end: float, out: float) -> None:
    """Set up a long wall, high as a noise barrier beside a motorway, perhaps overgrown."""
    kind = "wall" if builder.chance(0.6) else "boards"
    heights = (1.5, 3.5) if builder.plan.style.barrier else (1.0, 1.9)
    height, shade = builder.between(*heights), builder.between(0.6, 1.4)
    piece = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
    builder.put_line(piece, side, start, end, out)
    if builder.chance(0.4):
        ivy = partial(hedges.ivy, builder.rng, height=height * builder.between(0.5, 1.1))
        low = builder.between(start, (start + end) / 2)
        builder.put_line(ivy, side, low, builder.between(low, end), out - 0.15)


def median(builder: Builder) -> None:
    """Separate the directions of traffic by a crash barrier."""
    plan, shade = builder.plan, builder.between(0.6, 1.3)
    piece = partial(fences.fence, builder.rng, kind="barrier", height=0.8, shade=shade)
    builder.put_line(piece, plan.sides[0], 0.0, plan.length, -plan.half)
