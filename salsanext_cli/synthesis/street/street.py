# SPDX-License-Identifier: MIT
"""A whole street: the ground, all that stands on it, all that moves."""

from dataclasses import replace

from salsanext_cli.synthesis.mesh import Mesh, Rng, merge
from salsanext_cli.synthesis.presets import Style
from salsanext_cli.synthesis.street import boundaries, lots, roadside
from salsanext_cli.synthesis.street.brightness import draw_brightness, with_brightness
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.draw import draw_plan
from salsanext_cli.synthesis.street.ground import ground
from salsanext_cli.synthesis.street.plan import RUN_OUT_M, Plan
from salsanext_cli.synthesis.street.traffic import Mover, moving


def build_street(
    rng: Rng, style: Style, distance: float, ego_speed: float
) -> tuple[Plan, Mesh, tuple[Mover, ...]]:
    """Build a street on which the recording vehicle can drive `distance` metres.

    Returns `plan`, the ground plan; `standing`, all that keeps still, world coordinates; `movers`,
    all that moves.
    """
    plan = draw_plan(rng, style, distance + 2 * RUN_OUT_M)
    builder = Builder(rng, plan)
    builder.parts.append(ground(rng, plan))
    for side in plan.sides:
        roadside.furnish(builder, side)
        for lot in side.lots:
            lots.furnish(builder, side, lot)
    duration = distance / ego_speed
    if style.barrier:
        boundaries.median(builder)
    movers = moving(builder, ego_speed, duration)
    of_material = draw_brightness(rng)
    standing = with_brightness(merge(builder.parts), of_material)
    movers = tuple(replace(m, mesh=with_brightness(m.mesh, of_material)) for m in movers)
    return plan, standing, movers
