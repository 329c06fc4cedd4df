# SPDX-License-Identifier: MIT
"""Sensors: the geometry of their range images and how these are normalised, within limits."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

from salsanext_cli.errors import UsageError, quoted, shortened
from salsanext_cli.files.yaml_toml import are_numbers, read_toml, refuse_unknown

MAX_PIXELS = 1 << 21  # Largest range image: 64×32768, eight times the finest sensor
BYTES_PER_PIXEL = 1000  # Approximate memory of a network per pixel
MAX_NUMBER = 1e6
"""Bound of means, deviations and scales, in metres and units of intensity, and of their inverse."""
SCALES = f"from {1 / MAX_NUMBER:g} to {MAX_NUMBER:g}"
NOISE = ("range_noise", "intensity_noise")
MIN_LENGTH = 1e-3  # Least length of a vector that tells a direction
INTENSITY_LEVELS = 65  # Quantiles of intensity, evenly spaced
BOX_EXPECTED = "six numbers in metres, the least x, y, z and then the largest, or none"
MAX_COLUMNS = 64
COLUMNS_EXPECTED = (
    f"up to {MAX_COLUMNS} different names in lower case, with x, y and z, "
    "such as x,y,z,intensity,ring"
)
UNUSED_COLUMN = "_"  # Name of columns without meaning; only it may occur twice

SEMANTIC_KITTI_MEANS = (12.12, 10.88, 0.23, -1.04, 0.21)
SEMANTIC_KITTI_STDS = (12.32, 11.47, 6.91, 0.86, 0.16)
NO_VIEW = ("name", *NOISE, "intensity_quantiles", "row_gaps", "traits")
OF_IMAGES = ("height", "width", "means", "stds")
"""Fields that a network depends on, not a sensor: size and normalisation of its images."""
OF_DEVICE = ("name", "intensity_scale", *NOISE)  # Fields of a built-in sensor for any images
UP = (0.0, 0.0, 1.0)  # Direction of the z axis, away from the ground
ORIGIN = (0.0, 0.0, 0.0)
FITTED_NAME = "fitted"  # Name of a sensor whose view or mounting was found from scans
OPTIONAL = (
    *(*NOISE, "columns", "up", "origin", "intensity_quantiles", "row_gaps", "min_range", "ego_box"),
    *("traits", "others"),
)
"""Fields that are written only where a sensor has another value than their default."""


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
        Standard deviation of an intensity, as the network is given it.
    columns : tuple of str
        Names of the columns of files that do not name them, in lower case, such as x, y, z,
        intensity, ring; empty for the usual ones of each format.
    up : 3 floats
        Direction away from the ground in the frame of the files; others than z are turned to it
        before the projection.
    origin : 3 floats
        Place of the sensor in the frame of the files, in metres; elsewhere than at their origin if
        that is the vehicle's.
    intensity_quantiles : tuple of float
        Quantiles of the intensity in its range images, after the division, at `INTENSITY_LEVELS`
        evenly spaced levels; empty if unknown. A network maps them to those of its training.
    row_gaps : float, optional
        Share of gaps in its range images (`geometry.row_gaps`); those of scans that have more than
        training had are filled.
    min_range : float, optional
        Range in metres below which points are no measurements, but the housing and the mount of
        the sensor. None if it is to be found; until then it leaves nothing out, as 0 does.
    ego_box : 6 floats or none, optional
        Box around what the sensor sees of its own vehicle, in its own frame, upright: least x, y,
        z, largest x, y, z in metres. Points in it are no measurements. Empty if it sees nothing of
        it, None if that is to be found.
    traits : tuple of float
        Traits of the scans that it was fitted to, where scans of several sensors are labelled
        together (`geometry.scan_traits`).
    others : tuple of Sensor
        Sensors that were fitted to the other scans then.
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
    up: tuple[float, ...] = UP
    origin: tuple[float, ...] = ORIGIN
    intensity_quantiles: tuple[float, ...] = ()
    row_gaps: float | None = None
    min_range: float | None = None
    ego_box: tuple[float, ...] | None = None
    traits: tuple[float, ...] = ()
    others: tuple[Sensor, ...] = ()

    def __post_init__(self) -> None:
        subject = f"sensor {shortened(self.name)}"
        for field in fields(self):
            value = getattr(self, field.name)
            is_possible, expected = POSSIBLE[field.name]
            if value != field.default and not is_possible(value):
                raise UsageError(subject, f"{field.name} {quoted(value)}", expected)
        if self.fov_up <= self.fov_down:
            raise UsageError(subject, f"fov_up {self.fov_up} ≤ fov_down {self.fov_down}")
        if (pixels := self.height * self.width) > MAX_PIXELS:
            size = f"size {shortened(self.height)}×{shortened(self.width)}"
            memory = f"{shortened(pixels * BYTES_PER_PIXEL // 10**9, 12)} GB"
            found = f"{size}, of which an image takes {memory} in a network"
            expected = f"at most {MAX_PIXELS} pixels, such as 64×{MAX_PIXELS // 64}"
            raise UsageError(subject, found, expected)

    @property
    def members(self) -> tuple[Sensor, ...]:
        """The sensor alone, and the others."""
        return replace(self, others=()), *self.others

    def without_noise(self) -> Sensor:
        """Return the sensor with what labels depend on, and its name."""
        others = tuple(each.without_noise() for each in self.others)
        return replace(self, others=others, range_noise=None, intensity_noise=None)

    def to_dict(self, without: Collection[str] = ()) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts, without the defaults of `OPTIONAL`."""
        values = asdict(self) | {"others": tuple(each.to_dict(without) for each in self.others)}
        optional = [each for each in fields(self) if each.name in OPTIONAL]
        usual = [each.name for each in optional if values[each.name] == each.default]
        return {k: value for k, value in values.items() if k not in usual and k not in without}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "sensor") -> Sensor:
        """Build a sensor from plain data; an unknown or missing key raises `UsageError`."""
        refuse_unknown(data, cls, source)
        if missing := [f.name for f in fields(cls) if f.default is MISSING and f.name not in data]:
            hint = "`salsanext inspect SCANS --fit FILE.toml` finds the view of scans"
            expected = "a sensor with fov_up, fov_down, height, width"
            raise UsageError(source, f"lacks {', '.join(missing)}", expected, hint)
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in data.items()
        }
        others = values.pop("others", ())
        if not (isinstance(others, tuple) and all(isinstance(each, Mapping) for each in others)):
            raise UsageError(source, f"others {quoted(others)}", "a list of sensors")
        return cls(**values, others=tuple(cls.from_dict(each, source) for each in others))

    def to_toml(self, *, images: bool = True) -> str:
        """Return a TOML file that `sensor` reads; size and normalisation only with `images`."""
        left_out = ("name",) if images else ("name", *OF_IMAGES)
        values = {key: value for key, value in self.to_dict().items() if key not in left_out}
        # What JSON writes for texts, numbers and lists of numbers is TOML as well.
        known = {key: value for key, value in values.items() if value is not None}
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in known.items())

    def view(self) -> dict[str, Any]:
        """Return plain data of the view of a network: all but name, noise and measured shares."""
        return self.to_dict(NO_VIEW)

    def resized(self, height: int | None = None, width: int | None = None) -> Sensor:
        """Return the same sensor with another image size."""
        height = self.height if height is None else height
        return replace(self, height=height, width=self.width if width is None else width)


@dataclass(frozen=True, slots=True)
class FittedView:
    """What a fit of the view to scans changes of a sensor."""

    name: str
    fov_up: float  # Edges of the field of view in degrees
    fov_down: float
    up: tuple[float, ...] = UP  # Direction away from the ground
    origin: tuple[float, ...] = ORIGIN  # Place of the sensor in the frame of the files, metres

    @classmethod
    def of(cls, sensor: Sensor) -> FittedView:
        """Return the view of a sensor."""
        return cls(sensor.name, sensor.fov_up, sensor.fov_down, sensor.up, sensor.origin)


def are_columns(names: tuple[str, ...]) -> bool:
    """Say whether names can be those of the columns of a table of points."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        return False
    used = [name for name in names if name != UNUSED_COLUMN]
    complete = not names or {"x", "y", "z"} <= set(used)
    plain = all(name == name.lower().strip() and name for name in names)
    return complete and plain and len(set(used)) == len(used) and len(names) <= MAX_COLUMNS


def is_box(values: Any) -> bool:
    """Return whether these are the least and the largest coordinates of a box, or nothing."""
    if values == ():
        return True
    return _are_in(values, count=6) and all(
        a < b for a, b in zip(values[:3], values[3:], strict=True)
    )


def _are_in(
    values: Any, least: float = -MAX_NUMBER, most: float = MAX_NUMBER, *, count: int
) -> bool:
    """Say whether values are so many numbers within bounds."""
    return are_numbers(values) and len(values) == count and all(least <= v <= most for v in values)


def _is_in(value: object, least: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> bool:
    return _are_in((value,), least, most, count=1)


def _are_quantiles(values: Any) -> bool:
    return _are_in(values, count=INTENSITY_LEVELS) and list(values) == sorted(values)


def _is_direction(values: Any) -> bool:
    return _are_in(values, count=3) and math.hypot(*values) > MIN_LENGTH


POSSIBLE: dict[str, tuple[Callable[[Any], bool], str]] = {
    "name": (lambda name: isinstance(name, str), "a text"),
    "fov_up": (_is_in, "a number of degrees"),
    "fov_down": (_is_in, "a number of degrees"),
    "height": (lambda length: type(length) is int and length >= 1, "a number of pixels"),
    "width": (lambda length: type(length) is int and length >= 1, "a number of pixels"),
    "means": (partial(_are_in, count=5), f"5 numbers up to {MAX_NUMBER:g}"),
    "stds": (partial(_are_in, least=1 / MAX_NUMBER, count=5), f"5 numbers {SCALES}"),
    "out_of_view": (lambda value: value in ("clamp", "drop"), "clamp or drop"),
    "intensity_scale": (partial(_is_in, least=1 / MAX_NUMBER), f"a number {SCALES}"),
    "range_noise": (partial(_is_in, least=0), "a deviation in metres"),
    "intensity_noise": (partial(_is_in, least=0), "a deviation"),
    "columns": (are_columns, COLUMNS_EXPECTED),
    "up": (_is_direction, "a direction, three numbers"),
    "origin": (partial(_are_in, count=3), "a place, three numbers in metres"),
    "intensity_quantiles": (_are_quantiles, f"{INTENSITY_LEVELS} numbers that rise"),
    "row_gaps": (partial(_is_in, least=0, most=1), "a share"),
    "min_range": (partial(_is_in, least=0), "a range in metres"),
    "ego_box": (is_box, BOX_EXPECTED),
    "traits": (are_numbers, "numbers"),
    "others": (lambda others: all(not each.others for each in others), "sensors of one kind each"),
}
"""Test and description of the possible values of each field of a sensor, its default aside."""


@cache
def presets() -> dict[str, Sensor]:
    """Return the built-in sensors by name."""
    text = resources.files("salsanext_cli").joinpath("presets/sensors.toml").read_text("utf-8")
    return {
        name: Sensor.from_dict({"name": name, **data}, name)
        for name, data in tomllib.loads(text).items()
    }


def sensor(name_or_file: str | Path, base: Sensor | None = None) -> Sensor:
    """Return the sensor of a preset's name or of a TOML file with one sensor's keys.

    Size and normalisation that the file does not tell are those of `base`, else of the HDL-64.

    Raises
    ------
    UsageError
        If there is no such preset or file, or the file does not describe a sensor.
    """
    if str(name_or_file) in presets():
        return presets()[str(name_or_file)]
    path = Path(name_or_file)
    data = read_toml(path, "sensor", presets() if base is None else ("auto", *presets()))
    known = (base or presets()["hdl64"]).to_dict()
    images = {key: known[key] for key in OF_IMAGES}
    return Sensor.from_dict({"name": path.stem, **images, **data}, path)
