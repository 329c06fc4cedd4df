# SPDX-License-Identifier: MIT
"""What moves along the street: vehicles, riders, people on foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salsanext_cli.synthesis import ids, people, vehicles
from salsanext_cli.synthesis.builder import Builder
from salsanext_cli.synthesis.mesh import Mesh
from salsanext_cli.synthesis.plan import Plan


@dataclass(frozen=True, slots=True)
class Mover:
    """A thing that keeps its speed and its distance from the centre line.

    Attributes
    ----------
    mesh : Mesh
        In its own frame, x forward.
    start : float
        Position along the street at time 0, metres.
    t : float
        Distance to the left of the centre line, metres.
    speed : float
        Along the street, metres per second; negative comes towards the start.
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


def populate(builder: Builder, ego_start: float, ego_speed: float, duration: float) -> list[Mover]:
    """Draw everything that moves while the recording vehicle drives by."""
    return [
        *_vehicles(builder, ego_start, ego_speed, duration),
        *_walkers(builder, duration),
        *_riders(builder, ego_start, ego_speed, duration),
    ]


def _moving(mesh: Mesh, label: int) -> Mesh:
    return mesh.relabelled(ids.MOVING[label])


def _vehicle(builder: Builder) -> Mesh:
    if builder.chance(0.12):
        return _moving(vehicles.truck(builder.rng), ids.TRUCK)
    return _moving(vehicles.car(builder.rng), ids.CAR)


def _vehicles(builder: Builder, start: float, speed: float, duration: float) -> list[Mover]:
    plan = builder.plan
    movers = []
    gap = 100 / plan.style.traffic
    s = start + builder.between(9, 40)
    while s < plan.length + speed * duration:
        movers.append(Mover(_vehicle(builder), s, -0.5 * plan.half, speed))
        s += builder.between(0.3, 1.7) * gap + 8
    s = start - builder.between(9, 50)
    while s > -speed * duration:
        movers.append(Mover(_vehicle(builder), s, -0.5 * plan.half, speed))
        s -= builder.between(0.3, 1.7) * gap + 8
    pace = speed * builder.between(0.5, 1.2)
    s = builder.between(0, 40)
    while s < plan.length + pace * duration:
        movers.append(Mover(_vehicle(builder), s, 0.5 * plan.half, -pace))
        s += builder.between(0.3, 1.7) * gap + 9
    return movers


def _walkers(builder: Builder, duration: float) -> list[Mover]:
    plan = builder.plan
    movers = []
    for side in plan.sides:
        for _ in range(int(builder.rng.poisson(0.35 * plan.style.crowd * plan.length / 100))):
            pace = builder.between(0.7, 1.6) * builder.rng.choice([-1, 1])
            s = builder.between(0, plan.length) - pace * duration / 2
            out = side.parking + builder.between(0.3, max(0.6, side.verge + side.sidewalk - 0.3))
            for _ in range(int(builder.rng.integers(1, 3))):
                t = side.sign * (plan.half + out + builder.rng.normal(0, 0.35))
                place = s + builder.rng.normal(0, 0.6)
                movers.append(
                    Mover(_moving(people.person(builder.rng), ids.PERSON), place, t, pace)
                )
    return movers


def _riders(builder: Builder, start: float, speed: float, duration: float) -> list[Mover]:
    plan = builder.plan
    movers = []
    for _ in range(1 + int(builder.rng.poisson(0.12 * plan.style.crowd * plan.length / 100))):
        sign = builder.rng.choice([-1, 1])
        pace = -sign * builder.between(0.5, 1.05) * speed
        # Passes the recording vehicle some time during the drive.
        meeting = builder.between(0, duration)
        s = start + speed * meeting - pace * meeting + builder.rng.normal(0, 22)
        t = sign * (plan.half + builder.between(-0.9, 0.9))
        movers.append(Mover(_moving(people.rider(builder.rng), ids.BICYCLIST), float(s), t, pace))
    return movers
