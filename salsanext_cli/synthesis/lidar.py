# SPDX-License-Identifier: MIT
"""Simulated measurement of one revolution: range and intensity of the pulses that return."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.files.optional_packages import import_open3d
from salsanext_cli.records import Mask
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.presets import Numbers
from salsanext_cli.synthesis.surfaces import OPTICS

GRAZING_COSINE = 0.14  # Cosine of incidence below which surfaces look darker
PATCH_FIRINGS = 11  # Length of runs of firings that lose their pulses to mirrors
USUAL_ECHO = 0.35  # Brightness that `gamma` does not change
EDGE_SHARE = 0.45  # Share of the pulses at an edge that hit both surfaces
PULSE_M = 1.2  # Distance between two surfaces up to which their echoes are one
LOST_AT_EDGE_SHARE = 0.3  # Share of the pulses on two surfaces farther apart that are lost
MIN_REFLECTED = 0.01
"""Brightness added to every surface before deciding whether a pulse returns."""
DETECTION_STEEPNESS = 2.2
"""Exponent with which the share of detected pulses rises around the threshold."""
DIFFUSE_BRIGHTNESS, DIFFUSE_SHARE, MAX_DIFFUSE = 0.3, 0.75, 0.9
"""Brightness of a glossy surface and its diffuse share, which grow in proportion up to the most."""
STRAIGHT_ON_SHARE, STRAIGHT_ON_EXPONENT = 0.6, 16
"""Share that a mirror returns straight on, and exponent of the cosine of incidence."""
POWER_EXPONENT = 3  # Exponent with which strong lasers lose fewer pulses on glossy surfaces
INTENSITY_NOISE = 0.02
"""Standard deviation of the reported brightness, and its negative bias."""
MAX_INTENSITY = 0.99
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
    distance, cosine = np.full(count, np.inf), np.ones(count)
    labels = np.zeros(count, np.uint32)
    materials, shades = np.zeros(count, np.int64), np.ones(count)
    for scene in scenes:
        reached, triangle, cos = scene.cast(rays)
        nearer = reached < distance
        hit = triangle[nearer]
        distance[nearer], cosine[nearer] = reached[nearer], cos[nearer]
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
    measured = blended + noise[1] * np.hypot(response.noise, roughness)
    returned &= (reach < response.farthest) & (measured > response.nearest) & ~lost_at_edge
    grazing = np.clip(cosine / GRAZING_COSINE, 0.01, 1) ** falloff
    echo = reflected * np.interp(reach, DISTANCES_M, RELATIVE_RESPONSE) * grazing
    amplified = response.gain * USUAL_ECHO * (echo / USUAL_ECHO) ** response.gamma * lasers.gain
    reported = amplified - lasers.offset + INTENSITY_NOISE * noise[2] - INTENSITY_NOISE
    intensity = np.round(np.clip(reported, 0, MAX_INTENSITY) * response.steps) / response.steps
    return np.where(returned, measured, np.nan), intensity, labels


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
