# SPDX-License-Identifier: MIT
"""Recorded drive through a street: a scan every few metres."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import RawIds
from salsanext_cli.records import Scan
from salsanext_cli.synthesis.beams import Beams, hdl64, hidden_by_vehicle
from salsanext_cli.synthesis.lidar import Scene, measure
from salsanext_cli.synthesis.mesh import Array, merge, turn_x, turn_y, turn_z
from salsanext_cli.synthesis.plan import Plan
from salsanext_cli.synthesis.street import MARGIN_M, Street, build_street
from salsanext_cli.synthesis.style import STYLES

MOUNT_M = 1.73
"""Height of the sensor above the road."""
SPEED_M_PER_S = (4.0, 12.0)
"""Slowest and fastest drive."""
VIEW_M = 90.0
"""Things farther away than this are left out."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One recorded revolution.

    Attributes
    ----------
    scan : Scan
        Points in the sensor frame at the middle of the revolution, the vehicle's motion removed.
    labels : (N,) uint32
        Raw ids.
    pose : (4, 4)
        Sensor frame to world.
    time : float
        Seconds since the first frame.
    """

    scan: Scan
    labels: RawIds
    pose: Array
    time: float


def record(seed: int, sequence: int, scans: int, spacing: float) -> Iterator[Frame]:
    """Yield the frames of one sequence; all randomness comes from (seed, sequence, frame).

    Parameters
    ----------
    seed, sequence : int
        Not negative; the sequence number also chooses the style of the street.
    scans : int
        How many frames.
    spacing : float
        Metres that the vehicle drives between two frames.
    """
    rng = np.random.default_rng([seed, sequence])
    speed = float(rng.uniform(*SPEED_M_PER_S))
    street = build_street(rng, STYLES[sequence % len(STYLES)], spacing * (scans - 1), speed)
    beams = hdl64(rng)
    track = _Track(rng, street.plan, speed)
    sensor = _Sensor(beams, ~hidden_by_vehicle(beams, rng))
    standing = Scene(street.standing)
    for index in range(scans):
        noise = np.random.default_rng([seed, sequence, index, 1])
        s, time = MARGIN_M + index * spacing, index * spacing / speed
        pose = track.pose(s)
        scenes = [standing, *_moving(street, time, pose)]
        yield _revolve(noise, scenes, sensor, track, s, pose, time)


def _moving(street: Street, time: float, pose: Array) -> list[Scene]:
    """Return what moves near the sensor at a time, as a scene if there is anything."""
    meshes = [mover.at(street.plan, time) for mover in street.movers]
    place = pose[:2, 3]
    near = [m for m in meshes if m is not None and np.hypot(*(m.vertices[0, :2] - place)) < VIEW_M]
    return [Scene(merge(near))] if near else []


def _revolve(
    noise: np.random.Generator,
    scenes: list[Scene],
    sensor: _Sensor,
    track: _Track,
    s: float,
    pose: Array,
    time: float,
) -> Frame:
    """Record one revolution around the moment at which the vehicle is at s."""
    starts, ways = _in_motion(track, s, sensor)
    rays = np.concatenate([starts, ways], 1)
    distance, intensity, labels = measure(noise, scenes, rays, sensor.gain, sensor.power)
    kept = np.isfinite(distance)
    world = starts[kept] + ways[kept] * distance[kept, None]
    points = (world - pose[:3, 3]) @ pose[:3, :3]
    scan = Scan(points.astype(np.float32), intensity[kept].astype(np.float32))
    return Frame(scan, labels[kept], pose, time)


class _Sensor:
    """The rays that the recording vehicle lets pass, R of them, sensor frame."""

    def __init__(self, beams: Beams, seen: npt.NDArray[np.bool_]) -> None:
        self.origins, self.directions, self.times = (values[seen] for values in beams.rays())
        self.gain = np.repeat(beams.gain, beams.columns)[seen]
        self.power = np.repeat(beams.power, beams.columns)[seen]


class _Track:
    """The path of the sensor: in its lane, swaying a little, pitching and rolling."""

    def __init__(self, rng: np.random.Generator, plan: Plan, speed: float) -> None:
        self.speed = speed
        self._plan = plan
        self._lane = min(0.0, 2.4 - plan.half, -0.3 * plan.half) + rng.normal(0, 0.1)
        self._sway = rng.normal(0, 0.12)
        self._waves = rng.uniform(0.3, 1, (3, 2)) * [2 * np.pi / 25, 2 * np.pi]
        self._tilt = rng.normal(0, np.radians(0.35), 2)

    def pose(self, s: float) -> Array:
        """Return sensor frame to world, (4, 4), at s."""
        wave = np.sin(self._waves[:, 0] * s + self._waves[:, 1])
        t = self._lane + self._sway * wave[0]
        foot = self._plan.world([s - 1, s, s + 1], t)
        ahead = foot[2] - foot[0]
        yaw = np.arctan2(ahead[1], ahead[0])
        slope = np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))
        pitch = -slope + self._tilt[0] + np.radians(0.25) * wave[1]
        roll = self._tilt[1] + np.radians(0.3) * wave[2]
        pose = np.eye(4)
        pose[:3, :3] = turn_z(yaw) @ turn_y(pitch) @ turn_x(roll)
        pose[:3, 3] = foot[1] + [0, 0, MOUNT_M]
        return pose


def _in_motion(track: _Track, s: float, sensor: _Sensor) -> tuple[Array, Array]:
    """Return world origins and directions of rays fired while the vehicle drives on.

    The pose goes linearly from the one at the beginning to the one at the end of the revolution;
    over a tenth of a second that is what it does.
    """
    start, end = sensor.times.min(), sensor.times.max()
    first, last = track.pose(s + track.speed * start), track.pose(s + track.speed * end)
    share = ((sensor.times - start) / (end - start))[:, None]

    def turned(vectors: Array) -> Array:
        mixed: Array = vectors @ first[:3, :3].T * (1 - share) + vectors @ last[:3, :3].T * share
        return mixed

    origins = first[:3, 3] * (1 - share) + last[:3, 3] * share + turned(sensor.origins)
    directions = turned(sensor.directions)
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)
