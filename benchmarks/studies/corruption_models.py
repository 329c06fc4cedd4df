# SPDX-License-Identifier: MIT
"""Models of fog, snow and other bad conditions, for labelled scans.

Each takes a scan, the raw ids of its points (N,) uint32, a level and a random generator, and
returns a new scan with its labels. Points are in the order that they had, and no point is added: an
echo of the scene is kept, changed or lost, or another takes its place on the same ray, which has
label 0 then, since nothing of the scene is there. Intensities are reflectivities, 0…1, and ranges
metres. The same generator state draws the same numbers for every level.

The signal of a surface of reflectivity ρ at range r is taken as ρ / r², times cos θ where the
angle of incidence is known; what is below `DETECTABLE` is lost, unless it was before.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli import Scan
from salsanext_cli.core.classes.label_space import RawIds

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

DETECTABLE = 6e-6
"""Signal in 1/m² below which an HDL-64 reports nothing: asphalt at 40 m, beside its border."""
MIN_REFLECTIVITY = 0.01
"""Reflectivity of what is reported as black."""
NEAREST_M, FARTHEST_M = 2.0, 80.0
"""Ranges between which echoes appear that are none of the scene."""
PULSE_M = 3.0
"""Length of air that one pulse of 20 ns lights at a time."""
FOG_M = np.arange(NEAREST_M, 32.0, PULSE_M)
"""Starts of the cells in which echoes of fog are sought."""
CLASSES_WITH_FILM = (40, 44, 48, 49, 60)
"""Raw ids of SemanticKITTI of hard ground: road, parking, sidewalk, other ground, lane marking."""
WATER_INDEX = 1.33
FILM_REFLECTED = 0.48
"""Share of the diffuse light below a film of water that its surface reflects back."""
ROUGHNESS_MM = 1.2
"""Film that fills the roughness of asphalt."""
FLAKE_REFLECTIVITY, FLAKE_GROWTH = 0.9, 2.15
"""Reflectivity of snowflakes, and their diameter over that of the drop that they melt to."""
APERTURE_M, DIVERGENCE = 0.01, 0.002
"""Diameter of a beam at the sensor, and its growth per metre."""
SNOW_M = np.arange(NEAREST_M, 30.0) + 0.5
"""Middles of the cells of 1 m in which flakes are sought."""
REVOLUTION_S, SPEED_PER_JITTER = 0.1, 400.0
"""Time of a revolution, and speed in m/s per metre of jitter."""
BEAM_DEG = 0.4375
"""Distance of the beams of an HDL-64: 28° / 64."""


@dataclass(frozen=True, slots=True, eq=False)
class CorruptedScan:
    """Scan of N points, and their raw ids (N,) uint32."""

    scan: Scan
    labels: RawIds


Model = Callable[[Scan, RawIds, float, np.random.Generator], CorruptedScan]


def fog(scan: Scan, labels: RawIds, per_km: float, rng: np.random.Generator) -> CorruptedScan:
    """Weaken echoes, and put echoes of fog in the place of weaker ones.

    At extinction α the signal is ρ exp(−2αr) / r². Fog of backscatter β = 0.046 α / ln 20 gives
    from each length L of `PULSE_M` a signal π β L x exp(−2αr) / r², where x, of mean 1 and
    exponentially distributed, is its unevenness; the strongest echo is reported. (Rasshofer et al.,
    Adv. Radio Sci. 9, 2011; Hahner et al., ICCV 2021.) The level is 1000 / visibility in m, and
    α = ln 20 / visibility.
    """
    extinction = np.log(20) * per_km / 1000
    ranges, signal = _ranges_and_signals(scan)
    transmitted = np.exp(-2 * extinction * ranges)
    depth = FOG_M + PULSE_M * rng.random((len(scan), len(FOG_M)))
    uneven = rng.exponential(size=depth.shape)
    reflectivity = np.pi * 0.046 * per_km / 1000 * PULSE_M * uneven
    reflectivity *= np.exp(-2 * extinction * depth)
    strength = np.where(depth < ranges[:, None], reflectivity / depth**2, 0)
    best = strength.argmax(axis=1)[:, None]
    strongest = np.take_along_axis(strength, best, 1)[:, 0]
    echo = strongest > np.maximum(signal * transmitted, DETECTABLE)
    depth_of_echo = np.take_along_axis(depth, best, 1)[:, 0]
    reflectivity_of_echo = np.take_along_axis(reflectivity, best, 1)[:, 0]
    return _in_air(scan, labels, transmitted, echo, depth_of_echo, reflectivity_of_echo)


def wet_ground(
    scan: Scan, labels: RawIds, film_mm: float, rng: np.random.Generator
) -> CorruptedScan:
    """Darken hard ground below a film of water, and lose what is too dark.

    The film covers the share f = film / roughness. There ρ becomes (1 − F)² ρ / (n² (1 − p ρ)): in
    and out through its surface, which reflects F away (Fresnel), spread by refraction, and
    reflected back p times (Lekner and Dorf, Appl. Opt. 27, 1988). The ground is level. (A film of
    water first in Hahner et al., CVPR 2022.)
    """
    ranges, _ = _ranges_and_signals(scan)
    ground = np.isin(labels & 0xFFFF, CLASSES_WITH_FILM) & (ranges > 0)
    cosine = np.zeros(len(scan))
    np.divide(np.abs(scan.points[:, 2]), ranges, out=cosine, where=ground)
    inside = np.sqrt(1 - (1 - cosine**2) / WATER_INDEX**2)
    across = (cosine - WATER_INDEX * inside) / (cosine + WATER_INDEX * inside)
    along = (WATER_INDEX * cosine - inside) / (WATER_INDEX * cosine + inside)
    through = (1 - (across**2 + along**2) / 2) ** 2 / WATER_INDEX**2
    covered = min(film_mm / ROUGHNESS_MM, 1.0)
    dry = np.maximum(scan.intensity, MIN_REFLECTIVITY).astype(float)
    share = np.where(ground, 1 - covered + covered * through / (1 - FILM_REFLECTED * dry), 1)
    darker = Scan(scan.points, (scan.intensity * share).astype(np.float32))
    before = np.full(len(scan), np.inf)
    np.divide(dry * cosine, ranges**2, out=before, where=ground)
    return _selected(darker, labels, ~_is_lost(before * share, before))


def snow(scan: Scan, labels: RawIds, mm_per_h: float, rng: np.random.Generator) -> CorruptedScan:
    """Put snowflakes in the place of weaker echoes, and weaken those behind them.

    Of N₀ exp(−ΛD) flakes per m³ and mm of melted diameter, N₀ = 3800 R^−0.87 and
    Λ = 2.55 R^−0.48 / mm at rate R (Gunn and Marshall, J. Meteorol. 15, 1958), a beam of
    diameter d meets those of its volume. One of diameter D sends back ρ (D / d)² / r². The first
    on the ray whose signal exceeds that of the surface is reported; the share of light that passes
    all is exp(−2κr), κ being the area of the flakes per volume. Snow on the ground is left out.
    """
    if not mm_per_h:
        return CorruptedScan(scan, labels)
    slope = 2.55 * mm_per_h**-0.48
    per_m3 = 3800 * mm_per_h**-0.87 / slope
    area = per_m3 * np.pi / 4 * 2 * FLAKE_GROWTH**2 / slope**2 * 1e-6
    ranges, signal = _ranges_and_signals(scan)
    transmitted = np.exp(-2 * area * ranges)
    beam = APERTURE_M + DIVERGENCE * SNOW_M
    needed = np.sqrt(np.maximum(signal * transmitted, DETECTABLE) / FLAKE_REFLECTIVITY)
    least_mm = 1000 * needed[:, None] * SNOW_M * beam / FLAKE_GROWTH
    met = per_m3 * np.pi / 4 * beam**2 * np.exp(-slope * least_mm)
    met = np.cumsum(np.where(ranges[:, None] > SNOW_M, met, 0), axis=1)
    first = rng.exponential(size=(len(scan), 1))
    echo = first[:, 0] < met[:, -1]
    cell = np.minimum((met <= first).sum(axis=1), len(SNOW_M) - 1)
    depth = np.minimum(SNOW_M[cell] + rng.uniform(-0.5, 0.5, len(scan)), ranges)
    least = np.take_along_axis(least_mm, cell[:, None], 1)[:, 0]
    flake = FLAKE_GROWTH * (least + rng.exponential(size=len(scan)) / slope) / 1000
    reflectivity = FLAKE_REFLECTIVITY * np.minimum(flake / beam[cell], 1) ** 2
    return _in_air(scan, labels, transmitted, echo, depth, reflectivity)


def motion_blur(
    scan: Scan, labels: RawIds, jitter: float, rng: np.random.Generator
) -> CorruptedScan:
    """Jitter points, and leave the motion during a revolution in them.

    x' = x − v t + ε with ε ~ N(0, jitter²) in metres along each axis, speed v forward in proportion
    to it, and t in ± half a revolution by the azimuth. (Robo3D, ICCV 2023, has the jitter.)
    """
    noise = rng.normal(size=scan.points.shape)
    time = REVOLUTION_S * np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi)
    moved = scan.points + jitter * noise
    moved[:, 0] -= SPEED_PER_JITTER * jitter * time
    return CorruptedScan(Scan(moved.astype(np.float32), scan.intensity), labels)


def missing_beams(
    scan: Scan, labels: RawIds, share: float, rng: np.random.Generator
) -> CorruptedScan:
    """Lose all points of a share of the beams, drawn without replacement."""
    beam = _beams(scan)
    beams = rng.permutation(np.unique(beam))
    return _selected(scan, labels, ~np.isin(beam, beams[: round(share * len(beams))]))


def crosstalk(scan: Scan, labels: RawIds, share: float, rng: np.random.Generator) -> CorruptedScan:
    """Put pulses of another sensor in the place of a share of the echoes, at any range."""
    hit = rng.random(len(scan)) < share
    depth = rng.uniform(NEAREST_M, FARTHEST_M, len(scan))
    hit &= _ranges_and_signals(scan)[0] > 0
    return _with_echoes(scan, labels, hit, depth, rng.random(len(scan)))


def incomplete_echo(
    scan: Scan, labels: RawIds, share: float, rng: np.random.Generator
) -> CorruptedScan:
    """Lose weak echoes, of what is dark or far: half of those at a quantile of the signal s.

    One is detected with probability 1 / (1 + (s₀ / s)^2.2), s₀ being the quantile. (Robo3D thins
    out vehicles instead.)
    """
    _, signal = _ranges_and_signals(scan)
    half = np.quantile(signal, share) if share else 0.0
    return _selected(scan, labels, rng.random(len(scan)) < 1 / (1 + (half / signal) ** 2.2))


def other_sensor(
    scan: Scan, labels: RawIds, step: float, rng: np.random.Generator
) -> CorruptedScan:
    """Keep only every so many-th beam."""
    return _selected(scan, labels, _beams(scan) % round(step) == 0)


LEVELS: dict[str, tuple[Model, tuple[float, float, float, float]]] = {
    "fog": (fog, (0, 1000 / 300, 1000 / 100, 1000 / 50)),
    "wet ground": (wet_ground, (0, 0.2, 0.6, 1.2)),
    "snow": (snow, (0, 0.5, 1.0, 2.5)),
    "motion blur": (motion_blur, (0, 0.01, 0.02, 0.05)),
    "missing beams": (missing_beams, (0, 0.25, 0.5, 0.75)),
    "crosstalk": (crosstalk, (0, 0.01, 0.02, 0.05)),
    "incomplete echo": (incomplete_echo, (0, 0.1, 0.25, 0.45)),
    "other sensor": (other_sensor, (1, 2, 3, 4)),
}
"""Model of each corruption, and its levels: none, and the three severities."""


def _ranges_and_signals(scan: Scan) -> tuple[Array, Array]:
    """Return range in m and signal in 1/m², 0 and infinite of points without a measurement."""
    ranges = np.linalg.norm(scan.points.astype(float), axis=1)
    ranges[~np.isfinite(ranges)] = 0
    signal = np.full(len(scan), np.inf)
    reflectivity = np.maximum(scan.intensity, MIN_REFLECTIVITY)
    np.divide(reflectivity, ranges**2, out=signal, where=ranges > 0)
    return ranges, signal


def _is_lost(signal: Array, before: Array) -> Mask:
    """Return which signals (N,) are not detected, of those that were detected before."""
    return signal < np.minimum(DETECTABLE, before)


def _beams(scan: Scan) -> npt.NDArray[np.int64]:
    """Return the beam of each point: the step of its elevation."""
    x, y, z = np.nan_to_num(scan.points.astype(float)).T
    return np.floor(np.degrees(np.arctan2(z, np.hypot(x, y))) / BEAM_DEG).astype(np.int64)


def _in_air(
    scan: Scan, labels: RawIds, transmitted: Array, echo: Mask, ranges: Array, reflectivity: Array
) -> CorruptedScan:
    """Let a share (N,) of the light through, lose what is too weak then, and put echoes on rays."""
    _, signal = _ranges_and_signals(scan)
    weaker = Scan(scan.points, (scan.intensity * transmitted).astype(np.float32))
    changed = _with_echoes(weaker, labels, echo, ranges, reflectivity)
    is_detected = echo | ~_is_lost(signal * transmitted, signal)
    return _selected(changed.scan, changed.labels, is_detected)


def _with_echoes(
    scan: Scan, labels: RawIds, where: Mask, ranges: Array, reflectivity: Array
) -> CorruptedScan:
    """Put other echoes on some rays, of label 0, at ranges (N,) with reflectivities (N,)."""
    points = scan.points.copy()
    intensity = scan.intensity.copy()
    labels = labels.copy()
    old = points[where].astype(float)
    points[where] = old * (ranges[where] / np.linalg.norm(old, axis=1))[:, None]
    intensity[where] = np.minimum(reflectivity[where], 1)
    labels[where] = 0
    return CorruptedScan(Scan(points, intensity), labels)


def _selected(scan: Scan, labels: RawIds, is_selected: Mask) -> CorruptedScan:
    """Return the points of a mask (N,), with their labels."""
    return CorruptedScan(scan.take(np.flatnonzero(is_selected)), labels[is_selected])
