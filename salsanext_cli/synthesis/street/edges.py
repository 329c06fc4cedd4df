# SPDX-License-Identifier: MIT
"""Barriers along the edge of the road: crash barriers, and railings before the pavement."""

from collections.abc import Iterator
from functools import partial

from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.plan import Side
from salsanext_cli.synthesis.things import fences

CLEAR_M = 3.0  # Distance of a barrier from side streets and driveways
KINDS = ("barrier", "barrier", "barrier", "block")
OUT_M = (0.3, 1.2)  # Distance of a crash barrier from the edge of the road


def furnish(builder: Builder, side: Side) -> None:
    """Set up a crash barrier, a railing or neither along parts of one side."""
    style = builder.plan.style
    if side.parking:
        return
    if builder.chance(style.crash_barrier):
        kind = KINDS[builder.rng.integers(len(KINDS))]
        _along(builder, side, kind, builder.between(0.75, 0.95), builder.between(*OUT_M), 90.0)
    elif side.sidewalk > 1.5 and builder.chance(style.railing):
        _along(builder, side, "railing", builder.between(0.8, 1.1), 0.35, 25.0)


def _along(
    builder: Builder, side: Side, kind: str, height: float, out: float, longest: float
) -> None:
    """Place a line of a kind along one stretch between side streets and driveways."""
    stretches = list(_free_stretches(builder, side))
    if not stretches:
        return
    low, high = stretches[builder.rng.integers(len(stretches))]
    length = min(high - low, builder.between(8, longest))
    start = builder.between(low, high - length)
    shade = builder.between(0.6, 1.3)
    piece = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
    builder.put_line(piece, side, start, start + length, out)


def _free_stretches(builder: Builder, side: Side) -> Iterator[tuple[float, float]]:
    """Yield the stretches of a side without side streets and driveways, 8 m or longer."""
    taken = [(c.s - c.half - c.corner, c.s + c.half + c.corner) for c in side.crossings]
    taken += [lot.drive for lot in side.lots if lot.drive[1] > lot.drive[0]]
    start = 0.0
    for low, high in sorted(taken):
        if low - CLEAR_M - start > 8:
            yield start, low - CLEAR_M
        start = max(start, high + CLEAR_M)
    if builder.plan.length - start > 8:
        yield start, builder.plan.length
