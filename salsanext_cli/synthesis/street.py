# SPDX-License-Identifier: MIT
"""A whole street: the ground, all that stands on it, all that moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis import lots, roadside
from salsanext_cli.synthesis.builder import Builder
from salsanext_cli.synthesis.draw import draw_plan
from salsanext_cli.synthesis.ground import ground
from salsanext_cli.synthesis.mesh import Mesh, merge
from salsanext_cli.synthesis.plan import Plan
from salsanext_cli.synthesis.style import Style
from salsanext_cli.synthesis.traffic import Mover, populate

MARGIN = 70.0
"""How far the street goes on behind the first and beyond the last scan, metres."""


@dataclass(frozen=True, slots=True)
class Street:
    """What there is to scan.

    Attributes
    ----------
    plan : Plan
        The ground plan.
    standing : Mesh
        All that keeps still, world coordinates.
    movers : tuple of Mover
        All that moves.
    """

    plan: Plan
    standing: Mesh
    movers: tuple[Mover, ...]


def build_street(
    rng: np.random.Generator, style: Style, distance: float, ego_speed: float
) -> Street:
    """Build a street on which the recording vehicle can drive `distance` metres."""
    plan = draw_plan(rng, style, distance + 2 * MARGIN)
    builder = Builder(rng, plan)
    builder.parts.append(ground(rng, plan))
    for side in plan.sides:
        roadside.furnish(builder, side)
        for lot in side.lots:
            lots.furnish(builder, side, lot)
    movers = populate(builder, MARGIN, ego_speed, distance / ego_speed)
    return Street(plan, merge(builder.parts), tuple(movers))
