# SPDX-License-Identifier: MIT
"""Objects between the directions of traffic: on medians and traffic islands."""

from functools import partial

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.things import fences, furniture, vegetation

NARROW_M = 0.8  # Half the width of a median from which trees grow on it
MARGIN_M = 0.3  # Distance of objects from the edge of a median


def furnish(builder: Builder) -> None:
    """Set up a crash barrier, plants, lamps and signs between the directions of traffic."""
    median = builder.plan.median
    is_strip = bool(median.spans) and max(high - low for low, high in median.spans) > 20
    if builder.plan.style.barrier or (is_strip and builder.chance(0.12)):
        _crash_barrier(builder)
    elif is_strip:
        fill = (_nothing, _trees, _hedge, _trees)[builder.rng.integers(4)]
        fill(builder)
    _signs(builder)
    if is_strip and builder.chance(0.4):
        _lamps(builder)


def _crash_barrier(builder: Builder) -> None:
    plan = builder.plan
    shade = builder.between(0.6, 1.3)
    kind, height = ("block", builder.between(0.8, 1.0)) if builder.chance(0.3) else ("barrier", 0.8)
    piece = partial(fences.fence, builder.rng, kind=kind, height=height, shade=shade)
    spans = plan.median.spans or ((0.0, plan.length),)
    for low, high in spans:
        builder.put_line(piece, plan.sides[0], low, high, -plan.half)


def _nothing(_builder: Builder) -> None:
    """Leave a median empty."""


def _trees(builder: Builder) -> None:
    """Plant a row of trees with bushes between some of them."""
    median = builder.plan.median
    if median.half < NARROW_M:
        return
    gap = builder.between(6, 25)
    room = median.half - MARGIN_M
    for low, high in median.spans:
        for s in np.arange(low + 1.5, high - 1.5, gap):
            t = builder.between(-0.5, 0.5) * room
            tree = vegetation.tree(builder.rng, builder.between(4, 12))
            _put(builder, tree, float(s), t, 0.6)
            if builder.chance(0.3):
                radius = min(room, builder.between(0.3, 1.0))
                bush = vegetation.bush(builder.rng, radius)
                _put(builder, bush, float(s) + gap / 2, 0.0, radius)


def _hedge(builder: Builder) -> None:
    """Plant a hedge or low bushes along the middle of the median."""
    median = builder.plan.median
    depth = min(builder.between(0.5, 1.4), 2 * median.half - MARGIN_M)
    height = builder.between(0.4, 1.5)
    ragged = builder.between(0.01, 0.1)
    hedge = partial(vegetation.hedge, builder.rng, height=height, depth=depth, ragged=ragged)
    for low, high in median.spans:
        builder.put_line(hedge, builder.plan.sides[0], low + 1, high - 1, -builder.plan.half)


def _signs(builder: Builder) -> None:
    """Set up signs and posts at the ends of medians and islands."""
    for low, high in builder.plan.median.spans:
        for s in (low + 0.6, high - 0.6):
            if builder.chance(0.5) and 1 < s < builder.plan.length - 1:
                make = furniture.sign if builder.chance(0.7) else furniture.post
                yaw = builder.rng.choice([-1, 1]) * np.pi / 2
                _put(builder, make(builder.rng), s, 0.0, 0.3, float(yaw))


def _lamps(builder: Builder) -> None:
    lamp = furniture.lamp(builder.rng)
    gap = builder.between(25, 45)
    for low, high in builder.plan.median.spans:
        for s in np.arange(low + 3, high - 3, gap):
            _put(builder, lamp, float(s), 0.0, 0.3)


def _put(builder: Builder, mesh: Mesh, s: float, t: float, radius: float, yaw: float = 0.0) -> None:
    """Place an object at (s, t) if it is free."""
    builder.put_if_free(mesh, builder.plan.sides[0], s, t - builder.plan.half, radius, yaw)
