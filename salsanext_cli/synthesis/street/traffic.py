# SPDX-License-Identifier: MIT
"""Objects in motion: vehicles in their lanes, riders, people along and across the street."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.synthesis.mesh import Mesh, Rng
from salsanext_cli.synthesis.presets import MOVING
from salsanext_cli.synthesis.street.builder import Builder, varied
from salsanext_cli.synthesis.street.plan import MULTILANE_HALF_WIDTH_M, RUN_OUT_M, Plan
from salsanext_cli.synthesis.things import buses, pedestrians, riders
from salsanext_cli.synthesis.things.vehicles import vehicle

HALF_CAR_M = 2.4
CLEAR_M = 5.0  # Smallest distance along the street of people in the path of the sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """Object with a constant velocity along and across the street."""

    mesh: Mesh  # In the frame of the object, x forward
    start: float  # Along the street at time 0, metres
    t: float  # To the left of the centre line at time 0, metres
    speed: float  # Metres per second; negative towards the start of the street
    across: float = 0.0  # Metres per second to the left

    def at(self, plan: Plan, time: float) -> Mesh | None:
        """Return the mesh in world coordinates at a time, None while it is off the street."""
        s = self.start + self.speed * time
        t = self.t + self.across * time
        if not 3 < s < plan.length - 3:
            return None
        yaw = float(plan.yaw(s)) + float(np.arctan2(self.across, self.speed))
        return self.mesh.moved(plan.world(s, t), yaw)


def draw_movers(builder: Builder, speed: float, duration: float) -> list[Mover]:
    """Draw everything in motion during a drive of a speed, metres per second, and duration."""
    movers = [*_vehicles(builder, speed, duration), *_walkers(builder, duration)]
    return [*movers, *_riders(builder, speed, duration), *_crossers(builder, speed, duration)]


def _vehicles(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield vehicles in all lanes; the recording vehicle uses the outer lane."""
    plan = builder.plan
    *others, outer = lanes(plan.half - plan.shoulder, plan.median.half)
    ahead = builder.between(9, 40)
    behind = builder.between(9, 50)
    drive = speed * duration
    for start, end in ((ahead, plan.length + drive), (-behind, -drive)):
        for s, mesh in _in_a_row(builder, RUN_OUT_M + start, end, 10):
            yield Mover(mesh=mesh, start=s, t=-outer, speed=speed)
    for t in others:
        pace = speed * builder.between(0.9, 1.3)
        for s, mesh in _in_a_row(builder, -pace * duration, plan.length, 10):
            yield Mover(mesh=mesh, start=s, t=-t, speed=pace)
    for t in (*others, outer):
        pace = speed * builder.between(0.5, 1.2)
        end = plan.length + pace * duration
        for s, mesh in _in_a_row(builder, builder.between(0, 40), end, 11):
            yield Mover(mesh=mesh, start=s, t=t, speed=-pace)


def lanes(edge: float, start: float = 0.0) -> list[float]:
    """Return the middles of the lanes from a median to the edge, metres from the centre line."""
    width = edge - start
    count = 1 if width < MULTILANE_HALF_WIDTH_M else int(width / MULTILANE_HALF_WIDTH_M) + 1
    return [start + (index + 0.5) / count * width for index in range(count)]


def _in_a_row(
    builder: Builder, start: float, end: float, room: float
) -> Iterator[tuple[float, Mesh]]:
    """Yield positions and vehicles from start to end, with gaps and room for every vehicle."""
    sign = 1 if end > start else -1
    gap = 100 / builder.plan.style.traffic
    while (end - start) * sign > 0:
        mesh = _vehicle(builder)
        reach = float(np.abs(mesh.vertices[:, 0]).max())
        longer = max(0.0, reach - HALF_CAR_M)
        start += sign * longer
        yield start, mesh
        start += sign * (builder.between(0.3, 1.7) * gap + room + longer)


def _vehicle(builder: Builder) -> Mesh:
    style = builder.plan.style
    is_tram = builder.chance(style.trams)
    mesh = buses.tram(builder.rng) if is_tram else vehicle(builder.rng, style.vehicles)
    return _in_motion(varied(mesh, builder.rng))


def _object(builder: Builder, make: Callable[[Rng], Mesh]) -> Mesh:
    return _in_motion(varied(builder.model(make), builder.rng))


def _in_motion(mesh: Mesh) -> Mesh:
    """Return an object with the raw ids of its classes in motion; others have none."""
    moving = np.arange(mesh.labels.max() + 1, dtype=np.uint32)
    for standing, in_motion in MOVING.items():
        moving[standing : standing + 1] = in_motion
    return replace(mesh, labels=moving[mesh.labels])


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
                yield Mover(mesh=_object(builder, pedestrians.walker), start=place, t=t, speed=pace)


def _riders(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield riders that meet the recording vehicle during the drive."""
    plan = builder.plan
    style = builder.plan.style
    for _ in builder.count(style.riders * (0.5 + 0.3 * plan.length / 100)):
        sign = builder.rng.choice([-1, 1])
        pace = -sign * builder.between(0.5, 1.05) * speed
        meeting = builder.between(0, duration)
        s = RUN_OUT_M + speed * meeting - pace * meeting + builder.rng.normal(0, 22)
        t = sign * max(2.3, plan.half + builder.between(-0.9, 0.9))
        is_bicyclist = builder.chance(0.55)
        make = riders.riding_bicyclist if is_bicyclist else riders.riding_motorcyclist
        yield Mover(mesh=_object(builder, make), start=float(s), t=t, speed=pace)


def _crossers(builder: Builder, speed: float, duration: float) -> Iterator[Mover]:
    """Yield people who cross the street, at side streets or elsewhere, clear of the sensor."""
    plan = builder.plan
    for _ in builder.count(0.04 * plan.style.crowd * plan.length / 100):
        s = builder.along()
        if plan.crossings and builder.chance(0.6):
            crossing = plan.crossings[builder.rng.integers(len(plan.crossings))]
            s = crossing.s + (crossing.half + builder.between(1.5, 4.5)) * builder.rng.choice(
                [-1, 1]
            )
        across = builder.between(0.7, 1.6) * builder.rng.choice([-1, 1])
        middle = builder.between(0, duration)
        for _ in range(int(builder.rng.choice([1, 1, 2, 3]))):
            place = s + builder.rng.normal(0, 0.6)
            t = -across * middle + builder.rng.normal(0, 1.0)
            if _is_clear(plan, place, t, across, speed):
                mesh = _object(builder, pedestrians.walker)
                yield Mover(
                    mesh=mesh, start=float(place), t=float(t), speed=0.0, across=float(across)
                )


def _is_clear(plan: Plan, s: float, t: float, across: float, speed: float) -> bool:
    """Return whether somebody who crosses is far ahead or behind while in the sensor's path."""
    lane = min(0.0, 2.4 + plan.shoulder - plan.half)
    times = (lane + np.array([-1.8, 1.8]) - t) / across
    ahead = s - RUN_OUT_M - speed * times
    return bool((ahead > CLEAR_M).all() or (ahead < -CLEAR_M).all())
