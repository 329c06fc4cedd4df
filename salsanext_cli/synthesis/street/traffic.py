# SPDX-License-Identifier: MIT
"""Moving objects in a street: vehicles, pedestrians, riders."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.synthesis import surfaces
from salsanext_cli.synthesis.mesh import Mesh
from salsanext_cli.synthesis.street.builder import Builder, varied
from salsanext_cli.synthesis.street.plan import MULTILANE_HALF_WIDTH_M, RUN_OUT_M, Plan
from salsanext_cli.synthesis.things import cycles, people
from salsanext_cli.synthesis.things.vehicles import vehicle


@dataclass(frozen=True, slots=True)
class Mover:
    """Object with a constant speed and distance from the centre line."""

    mesh: Mesh  # In the frame of the object, x forward
    start: float  # Along the street at time 0, metres
    t: float  # To the left of the centre line, metres
    speed: float  # Metres per second; negative towards the start of the street

    def at(self, plan: Plan, time: float) -> Mesh | None:
        """Return the mesh in world coordinates at a time, None while it is off the street."""
        s = self.start + self.speed * time
        if not 3 < s < plan.length - 3:
            return None
        yaw = float(plan.yaw(s)) + (np.pi if self.speed < 0 else 0.0)
        return self.mesh.moved(plan.world(s, self.t), yaw)


def moving(builder: Builder, ego_speed: float, duration: float) -> tuple[Mover, ...]:
    """Return moving objects of a drive of `duration` seconds at `ego_speed` metres per second."""
    movers = [*_vehicles(builder, ego_speed, duration), *_walkers(builder, duration)]
    return (*movers, *_riders(builder, ego_speed, duration))


def _vehicles(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield vehicles in all lanes; the recording vehicle uses the outer lane."""
    plan = builder.plan
    *others, outer = lanes(plan.half)
    ahead, behind = builder.between(9, 40), builder.between(9, 50)
    drive = speed * duration
    for start, end in ((ahead, plan.length + drive), (-behind, -drive)):
        for s in _in_a_row(builder, RUN_OUT_M + start, end, 10):
            yield Mover(_vehicle(builder), s, -outer, speed)
    for t in others:
        pace = speed * builder.between(0.9, 1.3)
        for s in _in_a_row(builder, -pace * duration, plan.length, 10):
            yield Mover(_vehicle(builder), s, -t, pace)
    for t in (*others, outer):
        pace = speed * builder.between(0.5, 1.2)
        for s in _in_a_row(builder, builder.between(0, 40), plan.length + pace * duration, 11):
            yield Mover(_vehicle(builder), s, t, -pace)


def lanes(half: float) -> list[float]:
    """Return the middles of the lanes of half a carriageway, metres from the centre line."""
    count = 1 if half < MULTILANE_HALF_WIDTH_M else int(half / MULTILANE_HALF_WIDTH_M) + 1
    return [(index + 0.5) / count * half for index in range(count)]


def _in_a_row(builder: Builder, start: float, end: float, room: float) -> Iterator[float]:
    """Yield positions of vehicles from start to end, with gaps and room for every vehicle."""
    sign, gap = 1 if end > start else -1, 100 / builder.plan.style.traffic
    while (end - start) * sign > 0:
        yield start
        start += sign * (builder.between(0.3, 1.7) * gap + room)


def _vehicle(builder: Builder) -> Mesh:
    return _in_motion(varied(vehicle(builder.rng), builder.rng))


def _in_motion(mesh: Mesh) -> Mesh:
    """Return an object with the raw id of its class in motion."""
    return replace(mesh, labels=np.full_like(mesh.labels, surfaces.MOVING[int(mesh.labels[0])]))


def _walkers(builder: Builder, duration: float) -> Iterator[Mover]:
    plan = builder.plan
    for side in plan.sides:
        for _ in builder.count(0.16 * plan.style.crowd * plan.length / 100):
            pace = builder.between(0.7, 1.6) * builder.rng.choice([-1, 1])
            s = builder.along() - pace * duration / 2
            out = side.parking + builder.between(0.3, max(0.6, side.verge + side.sidewalk - 0.3))
            for _ in range(int(builder.rng.choice([1, 1, 2, 2, 3, 4]))):
                t = side.sign * (plan.half + out + builder.rng.normal(0, 0.35))
                place = s + builder.rng.normal(0, 0.6)
                yield Mover(_in_motion(people.person(builder.rng)), place, t, pace)


def _riders(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield riders that meet the recording vehicle during the drive."""
    plan = builder.plan
    for _ in builder.count(0.5 + 0.06 * plan.style.crowd * plan.length / 100):
        sign = builder.rng.choice([-1, 1])
        pace = -sign * builder.between(0.5, 1.05) * speed
        meeting = builder.between(0, duration)
        s = RUN_OUT_M + speed * meeting - pace * meeting + builder.rng.normal(0, 22)
        t = sign * max(2.3, plan.half + builder.between(-0.9, 0.9))
        make = cycles.bicyclist if builder.chance(0.5) else cycles.motorcyclist
        yield Mover(_in_motion(make(builder.rng)), float(s), t, pace)
