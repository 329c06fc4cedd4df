# SPDX-License-Identifier: MIT
"""Simulated drive through a street with vehicles, pedestrians and riders."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.records import Scan
from salsanext_cli.synthesis.lidar import Rig, RigMaker, Scene, hdl64_rig, measure
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng, merge, rotation
from salsanext_cli.synthesis.presets import Numbers, style_of
from salsanext_cli.synthesis.street import crowd, edges, lots, medians, roadside, yards
from salsanext_cli.synthesis.street.brightness import draw_brightness
from salsanext_cli.synthesis.street.builder import Builder, with_brightness
from salsanext_cli.synthesis.street.ground import ground
from salsanext_cli.synthesis.street.layout import draw_plan
from salsanext_cli.synthesis.street.plan import RUN_OUT_M, Plan
from salsanext_cli.synthesis.street.traffic import Mover, draw_movers

SPEED_M_PER_S = (4.0, 12.0)  # Slowest and fastest drive
VIEW_M = 90.0  # Largest distance of recorded moving objects
FROM_KERB_M = 2.4  # Distance of the vehicle from the edge of its lane
SHORTEST_WAVE_M = 25.0  # Shortest period of sway, pitch and roll along the street
MAX_PITCH_DEG = 0.25  # Of the vehicle on its suspension
MAX_ROLL_DEG = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Street:
    """Street for one drive."""

    plan: Plan
    standing: Mesh  # Ground and all objects that do not move
    movers: tuple[Mover, ...]


def build_street(rng: Rng, style: Numbers, distance: float, ego_speed: float) -> Street:
    """Build a street for a drive of `distance` metres at `ego_speed` metres per second."""
    plan = draw_plan(rng, style, distance + 2 * RUN_OUT_M)
    builder = Builder(rng, plan)
    builder.parts.append(ground(rng, plan))
    for side in plan.sides:
        roadside.furnish(builder, side)
        crowd.furnish(builder, side)
        yards.furnish(builder, side)
        edges.furnish(builder, side)
        for lot in side.lots:
            lots.furnish(builder, side, lot)
    medians.furnish(builder)
    movers = draw_movers(builder, ego_speed, distance / ego_speed)
    brightness = draw_brightness(rng)
    standing = with_brightness(merge(builder.parts), brightness)
    coloured = [replace(mover, mesh=with_brightness(mover.mesh, brightness)) for mover in movers]
    return Street(plan=plan, standing=standing, movers=tuple(coloured))


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One recorded revolution."""

    scan: Scan  # In the sensor frame at mid-revolution, corrected for the motion of the vehicle
    labels: RawIds  # (N,) uint32: raw ids
    pose: Array  # (4, 4): sensor frame to world
    time: float  # Seconds since the first frame


def record(
    seed: int,
    sequence: int,
    scans: int,
    spacing: float,
    make_rig: RigMaker = hdl64_rig,
    make_scene: Callable[[Mesh], Scene] = Scene,
) -> Iterator[Frame]:
    """Yield the frames of one sequence.

    Seed, sequence and length of the drive determine the street, whatever the sensor; the sequence
    chooses its style and its mix of objects. Seed, sequence and frame determine the noise.

    Parameters
    ----------
    seed : int
        Random seed.
    sequence : int
        Number of the sequence.
    scans : int
        Number of frames.
    spacing : float
        Distance between two frames in metres.
    make_rig : callable
        Draws a sensor and its mounting.
    make_scene : callable
        Prepares a mesh for the casting of rays.

    Yields
    ------
    Frame
    """
    rng = np.random.default_rng([seed, sequence])
    speed = float(rng.uniform(*SPEED_M_PER_S))
    style = style_of(sequence)
    street = build_street(rng, style, spacing * (scans - 1), speed)
    rig = make_rig(rng)
    track = _Track(rng, street.plan, speed, rig)
    ray_origins, ray_directions, ray_times, lasers = rig.rays()
    standing = make_scene(street.standing)
    for index in range(scans):
        noise = np.random.default_rng([seed, sequence, index, 1])
        s = RUN_OUT_M + index * spacing
        time = index * spacing / speed
        pose = track.pose(s)
        scenes = [standing, *map(make_scene, _nearby(street, time, pose))]
        origins, directions = track.in_motion(s, ray_origins, ray_directions, ray_times)
        cast = np.concatenate([origins, directions], 1)
        distance, intensity, labels = measure(noise, scenes, cast, lasers, rig.response)
        returned = np.isfinite(distance)
        world = origins[returned] + directions[returned] * distance[returned, None]
        points = (world - pose[:3, 3]) @ pose[:3, :3]
        scan = Scan(points.astype(np.float32), intensity[returned].astype(np.float32))
        yield Frame(scan=scan, labels=labels[returned], pose=pose, time=time)


def _nearby(street: Street, time: float, pose: Array) -> list[Mesh]:
    """Return moving objects near the sensor at a time, merged into at most one mesh."""
    near = []
    for mover in street.movers:
        mesh = mover.at(street.plan, time)
        if mesh and np.hypot(*(mesh.vertices[0, :2] - pose[:2, 3])) < VIEW_M:
            near.append(mesh)
    return [merge(near)] if near else []


class _Track:
    """Path of the sensor: in its lane, swaying, pitching and rolling a little.

    Positions are ``s``, metres along the street, and ``t``, metres to its left, as in a `Plan`.
    """

    def __init__(self, rng: Rng, plan: Plan, speed: float, rig: Rig) -> None:
        self._speed = speed
        self._plan = plan
        middle_of_lane = min(0.0, FROM_KERB_M + plan.shoulder - plan.half)
        self._lane = middle_of_lane + rng.normal(0, 0.1)
        self._sway = rng.normal(0, 0.12)
        # Angular frequency along s and phase of sway, pitch and roll
        self._waves = rng.uniform(0.3, 1, (3, 2)) * [2 * np.pi / SHORTEST_WAVE_M, 2 * np.pi]
        self._tilt = rig.tilt
        self._mount = rig.mount

    def pose(self, s: float) -> Array:
        """Return the pose of the sensor at s, (4, 4): sensor frame to world."""
        wave = np.sin(self._waves[:, 0] * s + self._waves[:, 1])
        t = self._lane + self._sway * wave[0]
        foot = self._plan.world([s - 1, s, s + 1], t)
        ahead = foot[2] - foot[0]
        yaw = np.arctan2(ahead[1], ahead[0])
        slope = np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))
        pitch = -slope + self._tilt[0] + np.radians(MAX_PITCH_DEG) * wave[1]
        roll = self._tilt[1] + np.radians(MAX_ROLL_DEG) * wave[2]
        pose = np.eye(4)
        pose[:3, :3] = rotation("z", yaw) @ rotation("y", pitch) @ rotation("x", roll)
        pose[:3, 3] = foot[1] + [0, 0, self._mount]
        return pose

    def in_motion(
        self, s: float, origins: Array, directions: Array, times: Array
    ) -> tuple[Array, Array]:
        """Return origins and directions of rays in the world while the sensor moves past s.

        Parameters
        ----------
        s : float
            Position at time 0.
        origins : (R, 3) float64
            Origins of the rays in the sensor frame, metres.
        directions : (R, 3) float64
            Unit vectors in the sensor frame.
        times : (R,) float64
            Times of the rays in seconds; between the first and the last, the pose changes linearly.

        Returns
        -------
        origins : (R, 3) float64
            In the world, metres.
        directions : (R, 3) float64
            Unit vectors in the world.
        """
        start = times.min()
        end = times.max()
        first = self.pose(s + self._speed * start)
        last = self.pose(s + self._speed * end)
        share = ((times - start) / (end - start))[:, None]

        def turned(vectors: Array) -> Array:
            before = vectors @ first[:3, :3].T
            after = vectors @ last[:3, :3].T
            return before * (1 - share) + after * share

        starts = first[:3, 3] * (1 - share) + last[:3, 3] * share + turned(origins)
        mixed = turned(directions)
        return starts, mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
