# SPDX-License-Identifier: MIT
"""Records that stages exchange, with their shapes, dtypes, units and frames.

Coordinates are in the frame of the sensor: x forward, y left, z up. Lengths are in metres, angles
in radians unless a name contains ``deg``. N is the number of points of a scan, H × W the size of
its range image, C the number of classes including class 0, unlabelled.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Int = npt.NDArray[np.int32]
Double = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

Origin = tuple[float, ...]
"""Position of the sensor of a scan in the frame of its file, three floats in metres."""
Origins = dict[str, Origin]
"""Origins of registered scans, by name of the scan."""

CHANNELS = ("range", "x", "y", "z", "intensity")  # In the published order
MAX_RANGE_M = np.float32(1e6)  # Largest range of a measurement in a range image
MAX_INTENSITY = np.float32(1e6)  # Largest intensity of a measurement in a range image


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldSplit:
    """Field of a file whose values divide its points into scans or sensors."""

    field: str
    kind: str  # "sensor" or "scan" if each has one value; "time" if the times of points vary
    count: int  # Number of different values; of a sample


@dataclass(frozen=True, slots=True, kw_only=True)
class FileNotes:
    """What the file of a scan states beside its points."""

    fields: tuple[str, ...] = ()  # Names of the fields with numbers, without the coordinates
    missing_points: int = 0  # Points that its header states, but that it lacks
    split: FieldSplit | None = None  # Field that tells scans or sensors apart, if any
    # Position of the origin of the points in the coordinates of the file, metres
    frame: Origin = (0.0, 0.0, 0.0)
    # (N,) uint8: classification of the points of a LAS file, codes of the ASPRS
    codes: npt.NDArray[np.uint8] | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution of a LiDAR.

    Attributes
    ----------
    points : (N, 3) float32
        Cartesian coordinates in metres. Points at NaN, infinity or the origin are no
        measurements, belong to no pixel and get label 0.
    intensity : (N,) float32
        Returned intensity (remission), nominally 0…1.
    notes : FileNotes, optional
        What its file states beside the points.
    """

    points: Float
    intensity: Float
    notes: FileNotes = FileNotes()

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or self.points.dtype != np.float32:
            raise ValueError(f"points: {self.points.shape} {self.points.dtype}, not (N, 3) float32")
        if self.intensity.shape != self.points.shape[:1] or self.intensity.dtype != np.float32:
            raise ValueError(
                f"intensity: {self.intensity.shape} {self.intensity.dtype}, not (N,) float32"
            )

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: npt.NDArray[np.intp]) -> "Scan":
        """Return the points at the indices (K,), in their order."""
        return Scan(self.points.take(index, 0), self.intensity.take(index))


def normalised_intensity(values: npt.NDArray[Any], scale: float) -> Float:
    """Return intensities (N,) float32, nominally 0…1: bytes divided by 255, others by `scale`."""
    divisor = 255.0 if values.dtype == np.uint8 else scale
    # Signalling NaNs are valid: points without an intensity.
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32) / np.float32(divisor)


@dataclass(frozen=True, slots=True)
class RangeImage:
    """A scan seen from the sensor (paper eq. 1).

    Attributes
    ----------
    channels : (5, H, W) float32
        Range, x, y, z in metres and intensity of the nearest point per pixel; 0 where empty.
    pixel_of_point : (N,) int32
        Flat pixel index ``v * W + u`` of every point, -1 for none.
    point_of_pixel : (H, W) int32
        Index of the nearest point of every pixel, -1 where empty.
    point_range : (N,) float32
        Distance of every point from the sensor in metres; 0 for points without a pixel.
    """

    channels: Float
    pixel_of_point: Int
    point_of_pixel: Int
    point_range: Float

    @property
    def height(self) -> int:
        """H, the number of rows."""
        return int(self.channels.shape[1])

    @property
    def width(self) -> int:
        """W, the number of columns."""
        return int(self.channels.shape[2])
