# SPDX-License-Identifier: MIT
"""Simulated LiDAR: beams in order and time, rays that the vehicle blocks, pulses that return."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.optional_packages import import_open3d
from salsanext_cli.core.records import Mask
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import HDL64, OPTICS, TUFTED, VEHICLE_OUTLINES_DEG, Numbers
from salsanext_cli.synthesis.presets import RANDOM_SENSOR as BOUNDS

ENCODER_STEP_DEG = 0.09  # Resolution of the azimuth
REVOLUTION_S = 0.1
PARALLAX_DEG = 1.2  # Shift of the vehicle for lasers to the left and right of the axis
UPPER_BLOCK = (2.4, -8.0, 32)
LOWER_BLOCK = (-8.6, -23.9, 32)
"""Elevation of the first and the last beam of a block in degrees, and their number."""
AZIMUTH_STEP_DEG = 0.1667  # Angle between firings of a laser at 10 Hz
HDL64_MOUNT_M = 1.73
GRAZING_COSINE = 0.14  # Cosine of incidence below which surfaces look darker
PATCH_FIRINGS = 11  # Length of runs of firings that lose their pulses to mirrors
USUAL_ECHO = 0.35  # Brightness that `gamma` does not change
EDGE_SHARE = 0.45  # Share of the pulses at an edge that hit both surfaces
PULSE_M = 1.2  # Distance between two surfaces up to which their echoes are one
LOST_AT_EDGE_SHARE = 0.3  # Share of the pulses on two surfaces farther apart that are lost
MIN_REFLECTED = 0.01  # Brightness added to every surface before deciding whether a pulse returns
DETECTION_STEEPNESS = 2.2
"""Exponent with which the share of detected pulses rises around the threshold."""
DIFFUSE_BRIGHTNESS = 0.3
DIFFUSE_SHARE = 0.75
MAX_DIFFUSE = 0.9
"""Brightness of a glossy surface and its diffuse share, which grow in proportion up to the most."""
STRAIGHT_ON_SHARE = 0.6
STRAIGHT_ON_EXPONENT = 16
"""Share that a mirror returns straight on, and exponent of the cosine of incidence."""
POWER_EXPONENT = 3  # Exponent with which strong lasers lose fewer pulses on glossy surfaces
INTENSITY_NOISE = 0.02  # Standard deviation of the reported brightness, and its negative bias
MAX_INTENSITY = 0.99
ONE_TUFT_M = 8.0  # Distance up to which neighbouring pulses hit one tuft of grass
MOST_GROWTH = 4.0  # Largest factor of the roughness of tufts
LOGISTIC_SLOPE = 1.702
"""Slope at which the logistic function stands in for the normal distribution's integral."""
DISTANCES_M = (0.0, 4.0, 8.0, 13.0, 20.0, 28.0, 40.0, 80.0)
RELATIVE_RESPONSE = (0.82, 0.86, 0.92, 1.0, 1.05, 0.92, 0.66, 0.45)
"""Relative reported brightness by distance: optics and gain control of the sensor."""


class Lasers(NamedTuple):
    """Differences between lasers, by laser (L,) or by ray (R,)."""

    gain: Array  # Relative reported brightness
    offset: Array  # Reported brightness is lower by this
    power: Array  # Relative strength of the pulse


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Lasers of a sensor, L, the upper ones first."""

    elevation: Array  # (L,): radians
    azimuth: Array  # (L,): offset of the first firing, radians
    height: Array  # (L,): start of the beam above the origin of the sensor, metres
    aside: Array  # (L,): start of the beam to the left of the origin, metres
    lasers: Lasers  # Arrays (L,)
    columns: int  # Firings per revolution

    def azimuths(self) -> Array:
        """Return the azimuths of all firings, (L, columns), radians, anticlockwise from ahead."""
        tick = np.radians(ENCODER_STEP_DEG)
        step = np.arange(self.columns) * (2 * np.pi / self.columns)
        return np.floor(step / tick) * tick + self.azimuth[:, None]

    def rays(self) -> tuple[Array, Array, Array]:
        """Return origins and directions (L * columns, 3), sensor frame, and times (L * columns,).

        The order is that of KITTI's files: laser by laser from the top, and once around from ahead
        to the left. Times are in seconds; the sensor turns clockwise from behind and looks ahead
        at time 0.
        """
        azimuth = self.azimuths()
        elevation = np.broadcast_to(self.elevation[:, None], azimuth.shape)
        horizontal = np.cos(elevation)
        x = np.cos(azimuth)
        y = np.sin(azimuth)
        directions = np.stack([horizontal * x, horizontal * y, np.sin(elevation)], -1)
        aside = self.aside[:, None]
        height = np.broadcast_to(self.height[:, None], azimuth.shape)
        origins = np.stack([-y * aside, x * aside, height], -1)
        turned = np.mod(np.pi - azimuth, 2 * np.pi) / (2 * np.pi)
        times = (turned - 0.5) * REVOLUTION_S
        return origins.reshape(-1, 3), directions.reshape(-1, 3), times.reshape(-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A sensor and its mounting."""

    beams: Beams
    response: Numbers  # Of the receiver to returning pulses
    unblocked: Mask  # (L * columns,) bool: rays that the vehicle does not block
    mount: float  # Height above the road, metres
    tilt: Array  # (2,): pitch and roll of the mounting, radians

    def rays(self) -> tuple[Array, Array, Array, Lasers]:
        """Return origins, directions, times and lasers of the rays that leave the vehicle."""
        origins, directions, times = (values[self.unblocked] for values in self.beams.rays())
        lasers = (np.repeat(values, self.beams.columns) for values in self.beams.lasers)
        return origins, directions, times, Lasers(*(values[self.unblocked] for values in lasers))


RigMaker = Callable[[Rng], Rig]  # Draws a sensor and its mounting


def hidden_by_vehicle(beams: Beams, rng: Rng) -> Mask:
    """Return the rays that the recording vehicle blocks, (L * columns,); the mounting varies."""
    azimuth = np.degrees(beams.azimuths()) + PARALLAX_DEG * np.sign(beams.aside)[:, None]
    elevation = np.degrees(beams.elevation)[:, None]
    hidden = np.zeros(azimuth.shape, bool)
    for outline in VEHICLE_OUTLINES_DEG:
        corner, upper, lower = outline.T
        beyond = np.mod(azimuth - corner[0] - rng.normal(0, 0.3), 360)
        shift = rng.normal(0, 0.3)
        below = elevation < np.interp(beyond, corner - corner[0], upper, right=-90) + shift
        hidden |= below & (elevation > np.interp(beyond, corner - corner[0], lower, right=-90))
    return hidden.reshape(-1)


def _lasers(rng: Rng, count: int) -> Lasers:
    """Draw gain, offset and power of lasers; a few report much less brightness."""
    gain = rng.normal(1, 0.08, count)
    offset = np.abs(rng.normal(0, 0.012, count))
    weak = rng.random(count) < 0.1
    offset[weak] += rng.uniform(0.03, 0.2, int(weak.sum()))
    return Lasers(gain, offset, np.exp(rng.normal(0, 0.5, count)))


def hdl64_rig(rng: Rng) -> Rig:
    """Draw an HDL-64E with small deviations, and its mounting."""
    elevation = np.concatenate([np.linspace(*UPPER_BLOCK), np.linspace(*LOWER_BLOCK)])
    elevation = elevation + rng.normal(0, 0.045, 64) + rng.normal(0, 0.06)
    columns = round(360 / (AZIMUTH_STEP_DEG + rng.normal(0, 0.0006)))
    azimuth = rng.uniform(0, 2 * np.pi / columns, 64)
    height = np.repeat([0.05, 0.0], 32) + rng.normal(0, 0.003, 64)
    aside = np.tile([0.026, -0.026], 32)
    downwards = np.radians(np.sort(elevation)[::-1])
    beams = Beams(
        elevation=downwards,
        azimuth=azimuth,
        height=height,
        aside=aside,
        lasers=_lasers(rng, 64),
        columns=columns,
    )
    tilt = rng.normal(0, np.radians(0.35), 2)
    return Rig(
        beams=beams,
        response=HDL64,
        unblocked=~hidden_by_vehicle(beams, rng),
        mount=HDL64_MOUNT_M,
        tilt=tilt,
    )


def random_rig(rng: Rng) -> Rig:
    """Draw a random sensor and its mounting."""
    beams = _random_beams(rng)
    response = _random_response(rng)
    unblocked = ~_random_shadow(beams, rng)
    tilt = np.radians(rng.normal(0, BOUNDS.tilt, 2))
    return Rig(
        beams=beams,
        response=response,
        unblocked=unblocked,
        mount=float(rng.uniform(*BOUNDS.mount)),
        tilt=tilt,
    )


RIGS: dict[str, RigMaker] = {"hdl64": hdl64_rig, "random": random_rig}
"""Makers of the sensor of a sequence by name."""


def _random_beams(rng: Rng) -> Beams:
    lost = rng.uniform(*BOUNDS.lost_beams) * (rng.random() < BOUNDS.lost_beams_chance)
    elevation = _random_elevations(rng)
    elevation = elevation[rng.random(len(elevation)) >= lost]
    count = len(elevation)
    columns = min(int(rng.choice(BOUNDS.column_counts)), int(BOUNDS.max_rays / count))
    azimuth = rng.choice(BOUNDS.stagger) * rng.uniform(0, 2 * np.pi / columns, count)
    height = np.zeros(count)
    aside = rng.uniform(*BOUNDS.laser_aside) * np.resize([1.0, -1.0], count)
    return Beams(
        elevation=np.radians(elevation),
        azimuth=azimuth,
        height=height,
        aside=aside,
        lasers=_lasers(rng, count),
        columns=columns,
    )


def _random_elevations(rng: Rng) -> Array:
    """Draw elevations in degrees, highest first: evenly spaced, or denser near the horizon."""
    count = int(rng.choice(BOUNDS.beam_counts))
    upper = rng.uniform(*BOUNDS.upper_edge)
    lower = rng.uniform(*BOUNDS.lower_edge)
    between = np.linspace(upper, lower, 1001)
    density = np.ones(len(between))
    if rng.random() < BOUNDS.dense_chance:
        middle = rng.uniform(*BOUNDS.dense_elevation)
        width = rng.uniform(*BOUNDS.dense_width)
        bell = np.exp(-(((between - middle) / width) ** 2) / 2)
        density += rng.uniform(*BOUNDS.dense_factor) * bell
    above = np.cumsum(density)
    above = (above - above[0]) / (above[-1] - above[0])
    elevation = np.interp(np.linspace(0, 1, count), above, between)
    jitter = rng.normal(0, BOUNDS.elevation_jitter * (upper - lower) / count, count)
    return np.sort(elevation + jitter)[::-1]


def _random_response(rng: Rng) -> Numbers:
    low, high = np.log(list(BOUNDS.response.values())).T
    values = np.exp(rng.uniform(low, high)).tolist()
    response = dict(zip(BOUNDS.response, values, strict=True))
    return Numbers(**response, steps=int(rng.choice(BOUNDS.intensity_steps)))


def _random_shadow(beams: Beams, rng: Rng) -> Mask:
    """Draw the rays that the vehicle blocks: none, or below the outline of a car or a roof."""
    kind = rng.choice(BOUNDS.shadows)
    if kind == "none":
        return np.zeros(len(beams.elevation) * beams.columns, bool)
    if kind == "car":
        return hidden_by_vehicle(beams, rng)
    azimuth = beams.azimuths()
    wave = np.cos(2 * azimuth) * rng.uniform(*BOUNDS.roof_ahead_and_behind)
    wave = wave + np.cos(azimuth) * rng.uniform(*BOUNDS.roof_ahead)
    edge = -rng.uniform(*BOUNDS.roof_edge) + wave
    hidden: Mask = np.degrees(beams.elevation)[:, None] < edge
    return hidden.reshape(-1)


class Scene:
    """Triangles that rays can hit: a mesh in world coordinates."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        o3d = import_open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(mesh.vertices.astype(np.float32)),
            self._tensor(mesh.triangles.astype(np.uint32)),
        )

    def cast(self, rays: Array) -> tuple[Array, npt.NDArray[np.uint32], Array]:
        """Return distance (inf without a hit), triangle and |cos| of incidence of every ray."""
        hits = self._scene.cast_rays(self._tensor(rays.astype(np.float32)), nthreads=1)
        cosine = np.abs((hits["primitive_normals"].numpy() * rays[:, 3:]).sum(1))
        return hits["t_hit"].numpy().astype(float), hits["primitive_ids"].numpy(), cosine


def measure(
    rng: Rng, scenes: list[Scene], rays: Array, lasers: Lasers, response: Numbers
) -> tuple[Array, Array, RawIds]:
    """Measure the nearest hits in all scenes along rays (R, 6), origins and unit directions.

    Rays are sorted by azimuth. Returns distances (R,) in metres, NaN for lost pulses, intensities
    (R,), 0…1, and raw ids (R,) uint32.
    """
    count = len(rays)
    distance = np.full(count, np.inf)
    cosine = np.ones(count)
    labels = np.zeros(count, np.uint32)
    materials = np.zeros(count, np.int64)
    shades = np.ones(count)
    for scene in scenes:
        reached, triangle, cos = scene.cast(rays)
        nearer = reached < distance
        hit = triangle[nearer]
        distance[nearer] = reached[nearer]
        cosine[nearer] = cos[nearer]
        labels[nearer] = scene.mesh.labels[hit]
        materials[nearer], shades[nearer] = scene.mesh.materials[hit], scene.mesh.shades[hit]
    brightness, texture, falloff, gloss, roughness = OPTICS[materials].T
    reach = np.where(np.isfinite(distance), distance, response.farthest + 1)
    noise = rng.standard_normal((3, count))
    reflected = brightness * shades * np.exp(texture * noise[0] - texture**2 / 2)
    signal = lasers.power * (reflected + MIN_REFLECTED) * cosine / reach**2
    weakness = response.threshold / np.maximum(signal, 1e-12)
    detected = 1 / (1 + weakness**DETECTION_STEEPNESS)
    returned = rng.random(count) < detected * (1 - response.lost_pulses)
    returned &= _patchy(rng, count) >= _lost_to_gloss(reflected, cosine, gloss, lasers.power)
    blended, lost_at_edge = _edges(rng, reach)
    roughness = roughness * np.where(TUFTED[materials], _growth(reach), 1.0)
    measured = blended + noise[1] * np.hypot(response.noise, roughness)
    returned &= (reach < response.farthest) & (measured > response.nearest) & ~lost_at_edge
    grazing = np.clip(cosine / GRAZING_COSINE, 0.01, 1) ** falloff
    echo = reflected * np.interp(reach, DISTANCES_M, RELATIVE_RESPONSE) * grazing
    amplified = response.gain * USUAL_ECHO * (echo / USUAL_ECHO) ** response.gamma * lasers.gain
    reported = amplified - lasers.offset + INTENSITY_NOISE * noise[2] - INTENSITY_NOISE
    intensity = np.round(np.clip(reported, 0, MAX_INTENSITY) * response.steps) / response.steps
    return np.where(returned, measured, np.nan), intensity, labels


def _growth(reach: Array) -> Array:
    """Return the factor of the roughness of tufts at distances (R,) in metres."""
    # Near pulses of one row hit the same tuft; farther ones hit tops and gaps of different tufts.
    return np.clip(reach / ONE_TUFT_M, 1.0, MOST_GROWTH)


def _edges(rng: Rng, reach: Array) -> tuple[Array, Mask]:
    """Return distances (R,) of pulses that hit two surfaces at an edge, and which are lost."""
    step = np.diff(reach, append=reach[-1:])
    chance, share = rng.random((2, len(reach)))
    both = chance < EDGE_SHARE
    blended: Array = reach + share / 2 * step * (both & (np.abs(step) < PULSE_M))
    return blended, (np.abs(step) >= PULSE_M) & (chance < LOST_AT_EDGE_SHARE)


def _lost_to_gloss(reflected: Array, cosine: Array, gloss: Array, power: Array) -> Array:
    """Return the probability (R,) that a mirror reflects a pulse away from the sensor."""
    # Strong lasers still detect dirt: glass and dark paint return in some rows only.
    diffuse = np.minimum(MAX_DIFFUSE, DIFFUSE_SHARE * reflected / DIFFUSE_BRIGHTNESS)
    straight_on = STRAIGHT_ON_SHARE * cosine**STRAIGHT_ON_EXPONENT
    mirrored = gloss * (1 - straight_on) * (1 - diffuse)
    odds = mirrored / np.maximum(1 - mirrored, 1e-6) / power**POWER_EXPONENT
    return odds / (1 + odds)


def _patchy(rng: Rng, count: int) -> Array:
    """Return uniform numbers 0…1 (count,) that change slowly from firing to firing."""
    white = rng.standard_normal(count + PATCH_FIRINGS - 1)
    smooth = np.convolve(white, np.full(PATCH_FIRINGS, PATCH_FIRINGS**-0.5), "valid")
    return 1 / (1 + np.exp(-LOGISTIC_SLOPE * smooth))
