# SPDX-License-Identifier: MIT
"""Drive through a street and record a scan every few metres."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from salsanext_cli.records import RawIds, Scan
from salsanext_cli.synthesis.beams import blind, hdl64
from salsanext_cli.synthesis.lidar import Scene, as_scan, measure
from salsanext_cli.synthesis.mesh import Array, merge, turn_z
from salsanext_cli.synthesis.plan import Plan
from salsanext_cli.synthesis.street import MARGIN, build_street
from salsanext_cli.synthesis.style import STYLES

MOUNT = 1.73
"""Height of the sensor above the road, metres."""
SIGHT = 90.0
"""Things farther away than this are left out, metres."""


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
    """Yield the frames of one sequence; all chance comes from (seed, sequence, frame)."""
    rng = np.random.default_rng([seed, sequence])
    speed = float(rng.uniform(4, 12))
    street = build_street(rng, STYLES[sequence % len(STYLES)], spacing * (scans - 1), speed)
    beams = hdl64(rng)
    track = _Track(rng, street.plan)
    origins, directions, times = beams.rays()
    seen = ~blind(beams, rng)
    origins, directions, times = origins[seen], directions[seen], times[seen]
    gain = np.repeat(beams.gain, beams.columns)[seen]
    power = np.repeat(beams.power, beams.columns)[seen]
    standing = Scene(street.standing)
    for index in range(scans):
        noise = np.random.default_rng([seed, sequence, index, 1])
        s = MARGIN + index * spacing
        time = index * spacing / speed
        pose = track.pose(s)
        passing = [mover.at(street.plan, time) for mover in street.movers]
        near = [
            mesh
            for mesh in passing
            if mesh is not None and np.hypot(*(mesh.vertices[0] - pose[:3, 3])[:2]) < SIGHT
        ]
        scenes = [standing, Scene(merge(near))] if near else [standing]
        starts, ways = _in_motion(track, s, speed, times, origins, directions)
        rays = np.concatenate([starts, ways], 1)
        distance, intensity, labels = measure(noise, scenes, rays, gain, power)
        kept = np.isfinite(distance)
        world = starts[kept] + ways[kept] * distance[kept, None]
        points = (world - pose[:3, 3]) @ pose[:3, :3]
        yield Frame(as_scan(points, intensity[kept]), labels[kept], pose, time)


class _Track:
    """The path of the sensor: in its lane, swaying a little, pitching and rolling."""

    def __init__(self, rng: np.random.Generator, plan: Plan) -> None:
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
        pose[:3, :3] = turn_z(yaw) @ _turn_y(pitch) @ _turn_x(roll)
        pose[:3, 3] = foot[1] + [0, 0, MOUNT]
        return pose


def _turn_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _turn_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _in_motion(
    track: _Track, s: float, speed: float, times: Array, origins: Array, directions: Array
) -> tuple[Array, Array]:
    """Return world origins and directions of rays fired while the vehicle drives on.

    The pose goes linearly from the one at the beginning to the one at the end of the revolution;
    over a tenth of a second that is what it does.
    """
    first, last = track.pose(s + speed * times.min()), track.pose(s + speed * times.max())
    share = ((times - times.min()) / (times.max() - times.min()))[:, None]
    shift = first[:3, 3] * (1 - share) + last[:3, 3] * share

    def turned(vectors: Array) -> Array:
        mixed: Array = (vectors @ first[:3, :3].T) * (1 - share) + (
            vectors @ last[:3, :3].T
        ) * share
        return mixed

    ways = turned(directions)
    return shift + turned(origins), ways / np.linalg.norm(ways, axis=1, keepdims=True)
