# SPDX-License-Identifier: MIT
"""Sensors: the geometry of their range images and how these are normalised."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from salsanext_cli.errors import UsageError
from salsanext_cli.settings_files import read_toml, refuse_unknown, shortened, words_of

SEMANTIC_KITTI_MEANS = (12.12, 10.88, 0.23, -1.04, 0.21)
SEMANTIC_KITTI_STDS = (12.32, 11.47, 6.91, 0.86, 0.16)
MAX_PIXELS = 1 << 21
"""Largest range image, in pixels: 64×32768, eight times that of the finest sensor."""
BYTES_PER_PIXEL = 1000
"""Approximate memory of a network per pixel."""
MAX_NUMBER = 1e6
"""Bound of means, deviations and scales, in metres and units of intensity, and of their inverse."""
SCALES = f"numbers from {1 / MAX_NUMBER:g} to {MAX_NUMBER:g}"
NOISE = ("range_noise", "intensity_noise")
MAX_COLUMNS = 64
COLUMNS_EXPECTED = (
    f"up to {MAX_COLUMNS} different names in lower case, with x, y and z, "
    "such as x,y,z,intensity,ring"
)
UNUSED_COLUMN = "_"
"""Name of a column that means nothing; the only one that may occur more than once."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """Geometry and normalisation of a rotating LiDAR.

    Attributes
    ----------
    name : str
        Name in messages and records.
    fov_up, fov_down : float
        Upper and lower edge of the field of view in degrees, signed, above the horizon positive.
    height, width : int
        Size of the range image in pixels.
    means, stds : 5 floats
        Normalisation of range, x, y, z (metres) and intensity.
    out_of_view : {"clamp", "drop"}
        Treatment of points above or below the field of view: edge row, or no pixel.
    intensity_scale : float
        Divides the intensity of the files; 255 where a sensor writes bytes as numbers.
    range_noise : float, optional
        Standard deviation of a range in metres, along the ray.
    intensity_noise : float, optional
        Standard deviation of an intensity, after the division.
    columns : tuple of str
        Names of the columns of files that do not name them, in lower case, such as x, y, z,
        intensity, ring; empty for the usual ones of each format.
    """

    name: str
    fov_up: float
    fov_down: float
    height: int
    width: int
    means: tuple[float, ...] = SEMANTIC_KITTI_MEANS
    stds: tuple[float, ...] = SEMANTIC_KITTI_STDS
    out_of_view: str = "clamp"
    intensity_scale: float = 1.0
    range_noise: float | None = None
    intensity_noise: float | None = None
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._require(isinstance(self.name, str), "a name that is no text")
        self._require(math.isfinite(self.fov_up) and math.isfinite(self.fov_down), "fov not finite")
        self._require(
            self.fov_up > self.fov_down,
            f"fov_up {shortened(self.fov_up)} ≤ fov_down {shortened(self.fov_down)}",
        )
        size = f"size {shortened(self.height)}×{shortened(self.width)}"
        whole = all(type(length) is int and length >= 1 for length in (self.height, self.width))
        self._require(whole, size)
        memory = f"{shortened(self.height * self.width * BYTES_PER_PIXEL // 10**9, 12)} GB"
        self._require(
            self.height * self.width <= MAX_PIXELS,
            f"{size}, of which an image takes {memory} in a network",
            f"at most {MAX_PIXELS} pixels, such as 64×{MAX_PIXELS // 64}",
        )
        five = len(self.means) == len(self.stds) == 5
        self._require(five, "means and stds are not 5 numbers each")
        self._require(
            all(abs(mean) <= MAX_NUMBER for mean in self.means),
            f"means {shortened(self.means)}",
            f"numbers up to {MAX_NUMBER:g}",
        )
        self._require(
            all(1 / MAX_NUMBER <= std <= MAX_NUMBER for std in self.stds),
            f"stds {shortened(self.stds)}",
            SCALES,
        )
        self._require(
            self.out_of_view in ("clamp", "drop"), f"out_of_view {shortened(self.out_of_view)}"
        )
        scale = self.intensity_scale
        self._require(
            1 / MAX_NUMBER <= scale <= MAX_NUMBER, f"intensity_scale {shortened(scale)}", SCALES
        )
        for name in NOISE:
            noise = getattr(self, name)
            self._require(noise is None or 0 <= noise < math.inf, f"{name} {shortened(noise)}")
        self._require(
            are_columns(self.columns), f"columns {shortened(self.columns)}", COLUMNS_EXPECTED
        )

    def _require(self, holds: bool, found: str, expected: str = "a possible sensor") -> None:
        if not holds:
            raise UsageError(f"sensor {shortened(self.name)}", found, expected)

    @property
    def knows_noise(self) -> bool:
        """True if both noises are known."""
        return self.range_noise is not None and self.intensity_noise is not None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts; columns only where they are named."""
        values = asdict(self)
        return values if self.columns else {k: v for k, v in values.items() if k != "columns"}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "sensor") -> Sensor:
        """Build a sensor from plain data; an unknown or missing key raises `UsageError`."""
        refuse_unknown(data, cls, source)
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in data.items()
        }
        try:
            return cls(**values)
        except (TypeError, OverflowError) as error:
            raise UsageError(
                source, words_of(error), "a sensor with fov_up, fov_down, height, width"
            ) from error

    def to_toml(self) -> str:
        """Return the text of a TOML file that `sensor` reads; the file's name is the sensor's."""
        values = {key: value for key, value in self.to_dict().items() if key != "name"}
        # What JSON writes for texts, numbers and lists of numbers is TOML as well.
        known = {key: value for key, value in values.items() if value is not None}
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in known.items())

    def view(self) -> dict[str, Any]:
        """Return plain data of the view of a network: all but the name and the noise."""
        return {key: value for key, value in self.to_dict().items() if key not in ("name", *NOISE)}

    def resized(self, height: int | None = None, width: int | None = None) -> Sensor:
        """Return the same sensor with another image size."""
        return replace(
            self,
            height=self.height if height is None else height,
            width=self.width if width is None else width,
        )


def are_columns(names: tuple[str, ...]) -> bool:
    """Say whether names can be those of the columns of a table of points."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        return False
    used = [name for name in names if name != UNUSED_COLUMN]
    complete = not names or {"x", "y", "z"} <= set(used)
    plain = all(name == name.lower().strip() and name for name in names)
    return complete and plain and len(set(used)) == len(used) and len(names) <= MAX_COLUMNS


@cache
def presets() -> dict[str, Sensor]:
    """Return the built-in sensors by name."""
    text = resources.files("salsanext_cli").joinpath("presets/sensors.toml").read_text("utf-8")
    return {
        name: Sensor.from_dict({"name": name, **data}, name)
        for name, data in tomllib.loads(text).items()
    }


def sensor(name_or_file: str | Path) -> Sensor:
    """Return the sensor of a preset's name or of a TOML file with one sensor's keys.

    Raises
    ------
    UsageError
        If there is no such preset or file, or the file does not describe a sensor.
    """
    if str(name_or_file) in presets():
        return presets()[str(name_or_file)]
    path = Path(name_or_file)
    data = read_toml(path, "sensor", presets())
    return Sensor.from_dict({"name": path.stem, **data}, path)
