# SPDX-License-Identifier: MIT
"""Simulated measurement of one revolution: range and intensity of the pulses that return."""

from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import RawIds
from salsanext_cli.packages import import_open3d
from salsanext_cli.synthesis.mesh import Array, Mesh, Rng
from salsanext_cli.synthesis.surfaces import OPTICS

MAX_RANGE_M, MIN_RANGE_M = 81.0, 1.6
"""Largest and smallest reported range."""
RANGE_NOISE_M = 0.009
"""Standard deviation along the ray."""
SIGNAL_THRESHOLD = 6.0e-6
"""Signal (brightness · cos / range²) at which half of the pulses are lost."""
GRAZING_COSINE = 0.14
"""Cosine of incidence below which surfaces look darker."""
PATCH_FIRINGS = 11
"""Length of the runs of firings in which mirrors lose pulses."""
LOST_SHARE = 0.004
"""Share of pulses lost for no reason."""
DISTANCES_M = (0.0, 4.0, 8.0, 13.0, 20.0, 28.0, 40.0, 80.0)
RELATIVE_RESPONSE = (0.82, 0.86, 0.92, 1.0, 1.05, 0.92, 0.66, 0.45)
"""Reported brightness of one surface by distance: optics and gain control of the sensor."""


class Scene:
    """Triangles that rays can hit: a mesh in world coordinates.

    Raises
    ------
    MissingDependency
        If open3d cannot be loaded.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        o3d = import_open3d()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(mesh.vertices.astype(np.float32)),
            self._tensor(mesh.triangles.astype(np.uint32)),
        )

    def cast(self, rays: Array) -> tuple[Array, npt.NDArray[np.int64], Array]:
        """Return distance (inf where nothing is hit), triangle and |cos| of incidence per ray."""
        hits: dict[str, Any] = self._scene.cast_rays(
            self._tensor(rays.astype(np.float32)), nthreads=1
        )
        distance = hits["t_hit"].numpy().astype(float)
        triangle = hits["primitive_ids"].numpy().astype(np.int64)
        normals = hits["primitive_normals"].numpy()
        cosine = np.abs((normals * rays[:, 3:]).sum(1))
        return distance, np.where(np.isfinite(distance), triangle, 0), cosine


def measure(
    rng: Rng, scenes: list[Scene], rays: Array, gain: Array, power: Array
) -> tuple[Array, Array, RawIds]:
    """Measure along rays.

    Parameters
    ----------
    rng : numpy.random.Generator
        Of the noise.
    scenes : list of Scene
        The nearest hit over all of them counts.
    rays : (R, 6)
        Origins and unit directions, world coordinates.
    gain, power : (R,)
        Reported brightness and strength of the laser that fires each ray, 1 = usual.

    Returns
    -------
    distance : (R,)
        Metres, NaN where nothing came back.
    intensity : (R,)
        0…1.
    labels : (R,) uint32
        Raw ids.
    """
    distance, cosine = np.full(len(rays), np.inf), np.ones(len(rays))
    labels = np.zeros(len(rays), np.uint32)
    materials, shades = np.zeros(len(rays), np.int64), np.ones(len(rays))
    for scene in scenes:
        found, triangle, cos = scene.cast(rays)
        nearer = found < distance
        hit = triangle[nearer]
        distance[nearer], cosine[nearer] = found[nearer], cos[nearer]
        labels[nearer] = scene.mesh.labels[hit]
        materials[nearer], shades[nearer] = scene.mesh.materials[hit], scene.mesh.shades[hit]
    brightness, texture, falloff, gloss, roughness = OPTICS[materials].T
    reach = np.where(np.isfinite(distance), distance, MAX_RANGE_M + 1)
    noise = rng.standard_normal((3, len(rays)))
    reflected = brightness * shades * np.exp(texture * noise[0] - texture**2 / 2)
    kept = _returns(rng, reflected, cosine, reach, gloss, power)
    measured = reach + noise[1] * np.hypot(RANGE_NOISE_M, roughness)
    kept &= (reach < MAX_RANGE_M) & (measured > MIN_RANGE_M)
    grazing = np.clip(cosine / GRAZING_COSINE, 0.01, 1) ** falloff
    intensity = reflected * np.interp(reach, DISTANCES_M, RELATIVE_RESPONSE) * grazing * gain
    intensity = np.round(np.clip(intensity + 0.02 * noise[2] - 0.02, 0, 0.99), 2)
    return np.where(kept, measured, np.nan), intensity, labels


def _returns(
    rng: Rng, reflected: Array, cosine: Array, reach: Array, gloss: Array, power: Array
) -> npt.NDArray[np.bool_]:
    """Decide which pulses return."""
    chance = rng.random(len(reach))
    signal = power * (reflected + 0.01) * cosine / reach**2
    detected = 1 / (1 + (SIGNAL_THRESHOLD / np.maximum(signal, 1e-12)) ** 2.2)
    # A mirror sends the pulse back only when hit straight on. Strong lasers still see its dirt, so
    # that glass and dark paint come back in some rows and not in others.
    dull = np.minimum(0.9, 0.75 * reflected / 0.3)
    mirrored = gloss * (1 - 0.6 * cosine**16) * (1 - dull)
    odds = mirrored / np.maximum(1 - mirrored, 1e-6) / power**3
    away = odds / (1 + odds)
    kept = chance < detected * (1 - LOST_SHARE)
    reflected_back: npt.NDArray[np.bool_] = _patchy(rng, len(reach)) >= away
    return kept & reflected_back


def _patchy(rng: Rng, count: int) -> Array:
    """Return chances 0…1 that change slowly from firing to firing, (count,)."""
    white = rng.standard_normal(count + PATCH_FIRINGS - 1)
    smooth = np.convolve(white, np.full(PATCH_FIRINGS, PATCH_FIRINGS**-0.5), "valid")
    # The logistic function with this slope stands in for the normal distribution's integral.
    return 1 / (1 + np.exp(-1.702 * smooth))
