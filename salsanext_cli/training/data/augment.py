# SPDX-License-Identifier: MIT
"""Augmentations of labelled scans: those of the paper, mixing of scans, and windows of images.

Except for windows, they change points before the projection, so that the nearest point wins each
pixel. LaserMix (Kong et al. 2023) alternates two scans by bands of inclination, PolarMix (Xiao et
al. 2022) by sectors of azimuth, RangeFormer (Kong et al. 2023) by boxes of the range image; the
last two also paste points of rare classes of another scan.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.records import Double, Float, Indices, Mask, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.training.recipe import Recipe

SHIFT_LOW_M = (-5.0, -3.0, -1.0)
SHIFT_HIGH_M = (5.0, 3.0, 0.0)
MAX_DROPPED_SHARE = 0.5
"""Bounds of the shift along x, y and z, and of the share of dropped points."""
KINDS = ((True, False), (False, True), (True, True))
"""Kinds of checkerboards, of several bands or sectors or both: LaserMix, PolarMix, boxes."""
MIN_BANDS = 2  # Bands of a checkerboard
MAX_BANDS = 6
MAX_SECTOR_PAIRS = 3
PASTED_COPIES = 2  # Copies of pasted rare points, each at another angle
CLEAR_RADIUS_M = 3.0  # Radius without pasted points, for the vehicle


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedScan:
    """Scan of N points with the labels that a network learns from.

    Attributes
    ----------
    scan : Scan
        The points.
    labels : (N,) uint8
        Train ids of the points, or targets (see `targets`).
    """

    scan: Scan
    labels: TrainIds


def augment(annotated: AnnotatedScan, recipe: Recipe, random: np.random.Generator) -> AnnotatedScan:
    """Return a labelled scan turned, shifted, mirrored and thinned out, each by chance."""
    scan = annotated.scan
    chances = (recipe.rotate, recipe.shift, recipe.flip, recipe.drop)
    rotated, shifted, flipped, dropped = random.random(4) < chances
    points = scan.points
    if rotated:
        points = rotate(points, random.uniform(-np.pi, np.pi))
    if shifted:
        points = shift(points, random.uniform(SHIFT_LOW_M, SHIFT_HIGH_M))
    if flipped:
        points = points * np.array([1, -1, 1], np.float32)
    changed = AnnotatedScan(replace(scan, points=points), annotated.labels)
    if not dropped:
        return changed
    count = int(len(scan) * random.uniform(0, MAX_DROPPED_SHARE))
    return _taken(changed, np.sort(random.permutation(len(scan))[count:]))


def rotate(points: Float, angle: float) -> Float:
    """Turn points (N, 3) counter-clockwise about z by an angle in radians."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], np.float32)
    with np.errstate(invalid="ignore"):
        return points @ turn


def shift(points: Float, offset: Double) -> Float:
    """Move points (N, 3) by (3,) metres, except points at the origin, which are no measurements."""
    x, y, z = points.T != 0
    return points + (x | y | z)[:, None] * offset.astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkerboard:
    """Checkerboard over the directions of the rays of a sensor.

    Cell (i, j), band i of inclination from below and sector j of azimuth counter-clockwise, is odd
    if i + j is. The outer bands include the points beyond the field of view.
    """

    bands: int
    sectors: int  # 1 or even, so that neighbours differ all around
    azimuth: float  # End of the first sector, radians
    fov_down: float  # Degrees
    fov_up: float

    @classmethod
    def random(cls, sensor: Sensor, random: np.random.Generator) -> Self:
        """Draw bands, sectors or boxes with equal chance, their number and azimuth."""
        in_bands, in_sectors = KINDS[random.integers(len(KINDS))]
        bands = int(random.integers(MIN_BANDS, MAX_BANDS + 1)) if in_bands else 1
        sectors = 2 * int(random.integers(1, MAX_SECTOR_PAIRS + 1)) if in_sectors else 1
        return cls(
            bands=bands,
            sectors=sectors,
            azimuth=random.uniform(-np.pi, np.pi),
            fov_down=sensor.fov_down,
            fov_up=sensor.fov_up,
        )

    def odd(self, points: Float) -> Mask:
        """Return whether points (N, 3) lie in odd cells, (N,) bool."""
        # It changes at every border: of bands, a cone, or of two sectors, a plane.
        x, y, z = np.ascontiguousarray(points.T)
        odd = np.zeros(len(points), np.bool_)
        edges = np.radians(np.linspace(self.fov_down, self.fov_up, self.bands + 1)[1:-1])
        width = 2 * math.pi / self.sectors
        # The cell of points without a measurement does not matter, since no pixel shows them.
        with np.errstate(invalid="ignore", over="ignore"):
            flat = np.sqrt(x * x + y * y)
            for inclination in edges:
                odd ^= z > flat * np.float32(math.tan(inclination))
            for plane in range(self.sectors // 2):
                angle = self.azimuth + plane * width
                odd ^= y * np.float32(math.cos(angle)) > x * np.float32(math.sin(angle))
        return odd


def mix(even: AnnotatedScan, odd: AnnotatedScan, board: Checkerboard) -> AnnotatedScan:
    """Return the points of one scan in even cells of a board and of another in odd cells."""
    from_even = select(even, ~board.odd(even.scan.points))
    from_odd = select(odd, board.odd(odd.scan.points))
    return concatenate(from_even, from_odd)


def paste(onto: AnnotatedScan, pasted: AnnotatedScan, angles: Double) -> AnnotatedScan:
    """Return a scan with copies of the points of another, turned about z by angles in radians."""
    points = pasted.scan.points
    with np.errstate(invalid="ignore", over="ignore"):
        clear = np.hypot(points[:, 0], points[:, 1]) > CLEAR_RADIUS_M
    copied = select(pasted, clear & np.isfinite(points).all(axis=1))
    turned = [
        AnnotatedScan(replace(copied.scan, points=rotate(copied.scan.points, angle)), copied.labels)
        for angle in angles
    ]
    return concatenate(onto, *turned)


def select(annotated: AnnotatedScan, chosen: Mask) -> AnnotatedScan:
    """Return the chosen points of a labelled scan, (N,) bool."""
    # Indices take a fifth of the time of a mask.
    return _taken(annotated, np.flatnonzero(chosen))


def _taken(annotated: AnnotatedScan, index: Indices) -> AnnotatedScan:
    return AnnotatedScan(annotated.scan.take(index), annotated.labels.take(index))


def concatenate(*scans: AnnotatedScan) -> AnnotatedScan:
    """Return the points of all scans, in their order."""
    points = np.concatenate([annotated.scan.points for annotated in scans])
    intensity = np.concatenate([annotated.scan.intensity for annotated in scans])
    labels = np.concatenate([annotated.labels for annotated in scans])
    return AnnotatedScan(Scan(points, intensity), labels)


def choose_columns(
    truth: TrainIds, scored: Mask, width: int, on_class: float, random: np.random.Generator
) -> Indices:
    """Choose the columns, (width,), of a window that may cross the edge of the image.

    With probability `on_class` it contains a pixel of a class drawn evenly from the `scored` ones,
    (C,) bool, in truth (H, W). A width of 0, or above W, takes all columns.
    """
    whole = truth.shape[1]
    if width == 0 or width >= whole:
        return np.arange(whole)
    start = random.integers(whole)
    if random.random() < on_class:
        present = np.flatnonzero(np.bincount(truth.ravel(), minlength=len(scored)) * scored)
        if len(present):
            _, candidates = np.nonzero(truth == random.choice(present))
            start = random.choice(candidates) - random.integers(width)
    return (start + np.arange(width)) % whole
