# SPDX-License-Identifier: MIT
"""A whole street: the ground, all that stands on it, all that moves."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, merge
from salsanext_cli.synthesis.presets import Style
from salsanext_cli.synthesis.street import lots, roadside
from salsanext_cli.synthesis.street.builder import Builder
from salsanext_cli.synthesis.street.draw import draw_plan
from salsanext_cli.synthesis.street.plan import REACH_M, Plan
from salsanext_cli.synthesis.surfaces import Material
from salsanext_cli.synthesis.things import people, vehicles

MARGIN_M = 70.0
"""Length of the street behind the first scan and beyond the last one."""
KERB_M = 0.02
"""Half the depth of a kerb's face; the grid has lines at this distance from every edge."""
MATERIAL_OF = {
    surfaces.ROAD: Material.ASPHALT,
    surfaces.MARKING: Material.MARKING,
    surfaces.PARKING: Material.PAVING,
    surfaces.SIDEWALK: Material.PAVING,
    surfaces.TERRAIN: Material.GRASS,
}


@dataclass(frozen=True, slots=True)
class Mover:
    """A thing that keeps its speed and its distance from the centre line.

    Its mesh is in its own frame, x forward. At time 0 it is ``start`` metres along the street and
    ``t`` metres to the left; a negative ``speed``, in metres per second, leads towards the start.
    """

    mesh: Mesh
    start: float
    t: float
    speed: float

    def at(self, plan: Plan, time: float) -> Mesh | None:
        """Return it in world coordinates at a time, None while it is off the street."""
        s = self.start + self.speed * time
        if not 3 < s < plan.length - 3:
            return None
        yaw = float(plan.yaw(s)) + (np.pi if self.speed < 0 else 0.0)
        return self.mesh.moved(plan.world(s, self.t), yaw)


def build_street(
    rng: Rng, style: Style, distance: float, ego_speed: float
) -> tuple[Plan, Mesh, tuple[Mover, ...]]:
    """Build a street on which the recording vehicle can drive `distance` metres.

    Returns
    -------
    plan : Plan
        The ground plan.
    standing : Mesh
        All that keeps still, world coordinates.
    movers : tuple of Mover
        All that moves.
    """
    plan = draw_plan(rng, style, distance + 2 * MARGIN_M)
    builder = Builder(rng, plan)
    builder.parts.append(ground(rng, plan))
    for side in plan.sides:
        roadside.furnish(builder, side)
        for lot in side.lots:
            lots.furnish(builder, side, lot)
    duration = distance / ego_speed
    movers = (
        *_vehicles(builder, ego_speed, duration),
        *_walkers(builder, duration),
        *_riders(builder, ego_speed, duration),
    )
    return plan, merge(builder.parts), movers


def ground(rng: Rng, plan: Plan) -> Mesh:
    """Return the ground of a street; each cell has the label of its middle."""
    s_edges, t_edges = plan.edges()
    s = _lines(np.arange(0.0, plan.length + 1, 1.0), s_edges, 0.0, plan.length)
    across = np.concatenate([np.arange(-10, 10.1, 0.5), np.linspace(10, REACH_M, 26)])
    t = _lines(np.concatenate([across, -across]), t_edges, -REACH_M, REACH_M)
    grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
    vertices = plan.world(grid_s, grid_t)
    rough = (plan.label(grid_s, grid_t) == surfaces.TERRAIN) * rng.normal(0, 0.03, grid_s.shape)
    vertices[..., 2] += rough
    middle = plan.label(
        (grid_s[:-1, :-1] + grid_s[1:, 1:]) / 2, (grid_t[:-1, :-1] + grid_t[1:, 1:]) / 2
    )
    patches = _patches(rng, (s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2, plan.length)
    labels = np.repeat(middle.ravel(), 2)
    materials = np.zeros(len(labels), np.uint8)
    shades = np.ones(len(labels), np.float32)
    for label, material in MATERIAL_OF.items():
        materials[labels == label] = material
        shades[labels == label] = rng.uniform(0.85, 1.15)
    shades *= np.repeat(patches.ravel(), 2).astype(np.float32)
    shades *= np.repeat(rng.normal(1, 0.03, middle.size), 2).astype(np.float32)
    index = np.arange(grid_s.size).reshape(grid_s.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2)
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), labels, materials, shades)


def _patches(rng: Rng, s: Array, t: Array, length: float) -> Array:
    """Return the brightness of cells (s, t): mended asphalt, worn and wet places."""
    shade = np.ones((len(s), len(t)))
    for _ in range(int(length / 6)):
        centre = rng.uniform([0, -12], [length, 12])
        half = rng.uniform([0.4, 0.2], [9, 1.6])
        inside = (np.abs(s - centre[0]) < half[0])[:, None] & (np.abs(t - centre[1]) < half[1])
        shade[inside] *= rng.uniform(0.6, 1.2)
    return shade


def _lines(regular: Array, edges: Array, low: float, high: float) -> Array:
    lines: Array = np.unique(np.concatenate([regular, edges - KERB_M, edges + KERB_M]))
    lines = lines[(lines >= low) & (lines <= high)]
    apart: Array = lines[np.concatenate([[True], np.diff(lines) > 0.01])]
    return apart


def _vehicles(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield vehicles ahead of and behind the recording one, and those that come towards it."""
    plan = builder.plan
    t, way = 0.5 * plan.half, speed * duration
    for s in _in_a_row(builder, MARGIN_M + builder.between(9, 40), plan.length + way, 8):
        yield Mover(_vehicle(builder), s, -t, speed)
    for s in _in_a_row(builder, MARGIN_M - builder.between(9, 50), -way, 8):
        yield Mover(_vehicle(builder), s, -t, speed)
    pace = speed * builder.between(0.5, 1.2)
    for s in _in_a_row(builder, builder.between(0, 40), plan.length + pace * duration, 9):
        yield Mover(_vehicle(builder), s, t, -pace)


def _in_a_row(builder: Builder, start: float, end: float, room: float) -> Iterator[float]:
    """Yield places of vehicles from start to end, with gaps and the room that each takes."""
    sign, gap = 1 if end > start else -1, 100 / builder.plan.style.traffic
    while (end - start) * sign > 0:
        yield start
        start += sign * (builder.between(0.3, 1.7) * gap + room)


def _vehicle(builder: Builder) -> Mesh:
    if builder.chance(0.12):
        return vehicles.truck(builder.rng).relabelled(surfaces.MOVING[surfaces.TRUCK])
    return vehicles.car(builder.rng).relabelled(surfaces.MOVING[surfaces.CAR])


def _walkers(builder: Builder, duration: float) -> Iterator[Mover]:
    """Yield pedestrians, alone or in twos."""
    plan = builder.plan
    for side in plan.sides:
        for _ in builder.count(0.35 * plan.style.crowd * plan.length / 100):
            pace = builder.between(0.7, 1.6) * builder.rng.choice([-1, 1])
            s = builder.along() - pace * duration / 2
            out = side.parking + builder.between(0.3, max(0.6, side.verge + side.sidewalk - 0.3))
            for _ in range(int(builder.rng.integers(1, 3))):
                t = side.sign * (plan.half + out + builder.rng.normal(0, 0.35))
                place = s + builder.rng.normal(0, 0.6)
                person = people.person(builder.rng).relabelled(surfaces.MOVING[surfaces.PERSON])
                yield Mover(person, place, t, pace)


def _riders(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield riders, each of whom meets the recording vehicle some time during the drive."""
    plan = builder.plan
    for _ in range(1 + len(builder.count(0.12 * plan.style.crowd * plan.length / 100))):
        sign = builder.rng.choice([-1, 1])
        pace = -sign * builder.between(0.5, 1.05) * speed
        meeting = builder.between(0, duration)
        s = MARGIN_M + speed * meeting - pace * meeting + builder.rng.normal(0, 22)
        t = sign * (plan.half + builder.between(-0.9, 0.9))
        rider = people.rider(builder.rng).relabelled(surfaces.MOVING[surfaces.BICYCLIST])
        yield Mover(rider, float(s), t, pace)
