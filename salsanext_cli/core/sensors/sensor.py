# SPDX-License-Identifier: MIT
"""Sensors: geometry and normalisation of their range images."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import cache, partial
from importlib import resources
from operator import lt
from typing import Any

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.field_rules import FieldRule
from salsanext_cli.core.plain_data import are_numbers, refuse_unknown
from salsanext_cli.core.texts import quoted, shortened
from salsanext_cli.core.wording import argument, command, setting

MAX_PIXELS = 1 << 21  # Largest range image: 64×32768, eight times the finest sensor
MAX_NUMBER = 1e6  # Bound of means, deviations, scales and their inverse
SCALES = f"from {1 / MAX_NUMBER:g} to {MAX_NUMBER:g}"
NOISE = ("range_noise", "intensity_noise")
MIN_LENGTH = 1e-3  # Least length of a direction
INTENSITY_LEVELS = 65  # Quantiles of intensity, evenly spaced
BOX_EXPECTED = "six numbers in metres, least x, y, z and then largest, or none"
MAX_COLUMNS = 64
COLUMNS_EXPECTED = f"up to {MAX_COLUMNS} different names in lower case, such as x,y,z,ring"
FIELD_EXPECTED = "the name of a field other than x, y, z, such as scalar_Amplitude"
UNUSED_COLUMN = "_"  # Name of unused columns, the only one that may occur twice

SEMANTIC_KITTI_MEANS = (12.12, 10.88, 0.23, -1.04, 0.21)
SEMANTIC_KITTI_STDS = (12.32, 11.47, 6.91, 0.86, 0.16)
NO_VIEW = ("name", *NOISE, "intensity_quantiles", "row_gaps", "traits")
OF_IMAGES = ("height", "width", "means", "stds")
"""Size and normalisation of range images, which belong to a network."""
FIELD_OF_VIEW = ("fov_up", "fov_down")
OF_DEVICE = ("name", "intensity_scale", *NOISE)  # Fields of a built-in sensor for any images
UP = (0.0, 0.0, 1.0)  # Direction of the z axis, away from the ground
ORIGIN = (0.0, 0.0, 0.0)
FITTED_NAME = "fitted"  # Name of a sensor whose field of view or mounting was fitted to scans
OPTIONAL = (
    *NOISE,
    "columns",
    "up",
    "origin",
    "intensity_quantiles",
    "row_gaps",
    "min_range",
    "ego_box",
    "registered",
    "traits",
    "others",
    "intensity_field",
)
"""Fields that are only written if their value is not the default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Standard deviations of the measurements of a sensor."""

    range: float  # Metres, along the ray
    intensity: float  # After the division by `Sensor.intensity_scale`


@dataclass(frozen=True, slots=True)
class Sensor:
    """Geometry and normalisation of a rotating LiDAR.

    Attributes
    ----------
    name : str
        Name in messages and records.
    fov_up, fov_down : float
        Upper and lower edge of the field of view in degrees, positive above the horizon.
    height, width : int
        Size of the range image in pixels.
    means, stds : 5 floats
        Normalisation of range, x, y, z (metres) and intensity.
    out_of_view : {"clamp", "drop"}
        Pixels of points outside the field of view: edge row, or none.
    intensity_scale : float
        Divisor of the intensity of the files, such as 255.
    range_noise : float, optional
        Standard deviation of a range in metres, along the ray.
    intensity_noise : float, optional
        Standard deviation of an intensity after the division.
    columns : tuple of str
        Names, in lower case, of the columns of files without names, such as x, y, z, intensity,
        ring; empty for the usual ones of each format.
    intensity_field : str
        Name of the column with the intensity in files with names, or of `columns`; empty for the
        usual ones.
    up : 3 floats
        Direction away from the ground in the frame of the files; the projection turns it to z.
    origin : 3 floats
        Position of the sensor in the frame of the files, in metres.
    intensity_quantiles : tuple of float
        Quantiles of the intensity in its range images, after the division, at `INTENSITY_LEVELS`
        evenly spaced levels; empty if unknown. A network maps them to those of its training.
    row_gaps : float, optional
        Share of gaps in its range images (`geometry.row_gaps`); gaps are filled if the training
        scans had fewer.
    min_range : float, optional
        Range in metres below which points are the housing or mount of the sensor. None is to be
        estimated, and counts as 0 until then.
    ego_box : 6 floats or none, optional
        Upright box around the vehicle in the frame of the sensor: least x, y, z, largest x, y, z
        in metres. Points in it are ignored. Empty for no box; None is to be estimated.
    registered : bool
        Whether the files are registered to a map, so that each scan has its own origin, which is
        found from its points (`geometry.sensor_of_scan.sensor_of`).
    traits : tuple of float
        Traits of the scans that it was fitted to, if scans of several sensors are labelled
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
    intensity_field: str = ""
    up: tuple[float, ...] = UP
    origin: tuple[float, ...] = ORIGIN
    intensity_quantiles: tuple[float, ...] = ()
    row_gaps: float | None = None
    min_range: float | None = None
    ego_box: tuple[float, ...] | None = None
    registered: bool = False
    traits: tuple[float, ...] = ()
    others: tuple[Sensor, ...] = ()

    def __post_init__(self) -> None:
        subject = f"sensor {shortened(self.name)}"
        for field in fields(self):
            value = getattr(self, field.name)
            rule = FIELD_RULES[field.name]
            if value != field.default and not rule.allows(value):
                raise UsageError(subject, f"has {field.name} {quoted(value)}", rule.expected)
        if self.fov_up <= self.fov_down:
            raise UsageError(subject, f"has fov_up {self.fov_up} ≤ fov_down {self.fov_down}")
        if self.height * self.width > MAX_PIXELS:
            size = f"has {shortened(self.height)}×{shortened(self.width)} pixels"
            raise UsageError(subject, size, f"at most {MAX_PIXELS}, such as 64×{MAX_PIXELS // 64}")

    @property
    def members(self) -> tuple[Sensor, ...]:
        """The sensor alone, and the others."""
        return replace(self, others=()), *self.others

    @property
    def has_registered(self) -> bool:
        """Whether scans of a member are registered to a map."""
        return any(member.registered for member in self.members)

    def require_noise(self) -> SensorNoise:
        """Return the noise of the measurements; refuse a sensor that does not state it."""
        if self.range_noise is None or self.intensity_noise is None:
            expected = "range_noise in metres and intensity_noise"
            hint = f"write both into a sensor file and pass it with {argument('sensor')}"
            raise UsageError(f"sensor {self.name}", "states no noise", expected, hint)
        return SensorNoise(range=self.range_noise, intensity=self.intensity_noise)

    def without_noise(self) -> Sensor:
        """Return the sensor without its noise, which labels do not depend on."""
        others = tuple(other.without_noise() for other in self.others)
        return replace(self, others=others, range_noise=None, intensity_noise=None)

    def to_dict(self, without: Collection[str] = ()) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts, without the defaults of `OPTIONAL`."""
        values = asdict(self) | {"others": tuple(other.to_dict(without) for other in self.others)}
        optional = [field for field in fields(self) if field.name in OPTIONAL]
        omitted = {field.name for field in optional if values[field.name] == field.default}
        omitted.update(without)
        return {key: value for key, value in values.items() if key not in omitted}

    @classmethod
    def from_dict(
        cls, data: Mapping[str, Any], source: object = "sensor", *, is_file: bool = False
    ) -> Sensor:
        """Build a sensor from plain data; an unknown or missing key raises `UsageError`.

        Parameters
        ----------
        data : mapping
            Fields by name.
        source : object
            Origin of the data in errors.
        is_file : bool
            Whether the source is a file of a sensor, which the hint can name.

        Returns
        -------
        Sensor
        """
        refuse_unknown(data, cls, source)
        missing = [f.name for f in fields(cls) if f.default is MISSING and f.name not in data]
        if missing:
            inspect = command("salsanext inspect SCANS", setting("fit", "FILE.toml"))
            hint = f"estimate them with `{inspect}`"
            if is_file and data.keys().isdisjoint(FIELD_OF_VIEW):
                file = setting("sensor", source)
                inspect = command("salsanext inspect SCANS", file, setting("fit", "NEW.toml"))
                hint = f"run `{inspect}`, then use NEW.toml"
            expected = "a sensor with fov_up, fov_down, height, width"
            raise UsageError(source, f"lacks {', '.join(missing)}", expected, hint)
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in data.items()
        }
        others = values.pop("others", ())
        if not (isinstance(others, tuple) and all(isinstance(other, Mapping) for other in others)):
            raise UsageError(source, f"has others {quoted(others)}", "a list of sensors")
        sensors = [cls.from_dict(other, source, is_file=is_file) for other in others]
        return cls(**values, others=tuple(sensors))

    def to_toml(self, *, images: bool = True) -> str:
        """Return a TOML file that `sensor` reads; size and normalisation only with `images`."""
        values = self.to_dict(("name",) if images else ("name", *OF_IMAGES))
        # JSON of texts, numbers and lists of numbers is TOML as well.
        lines = [f"{k} = {json.dumps(value)}\n" for k, value in values.items() if value is not None]
        return "".join(lines)

    def view(self) -> dict[str, Any]:
        """Return plain data of all fields but name, noise and statistics of scans."""
        return self.to_dict(NO_VIEW)

    def resized(self, height: int | None = None, width: int | None = None) -> Sensor:
        """Return the sensor with another image size, in pixels; its members have the same."""
        height = self.height if height is None else height
        width = self.width if width is None else width
        others = tuple(replace(other, height=height, width=width) for other in self.others)
        return replace(self, height=height, width=width, others=others)


@dataclass(frozen=True, slots=True)
class FittedView:
    """Fields of a sensor that a fit to scans changes."""

    name: str
    fov_up: float  # Edges of the field of view in degrees
    fov_down: float
    up: tuple[float, ...] = UP  # Direction away from the ground
    origin: tuple[float, ...] = ORIGIN  # Position in the frame of the files, metres

    @classmethod
    def from_sensor(cls, sensor: Sensor) -> FittedView:
        """Return these fields of a sensor."""
        return cls(sensor.name, sensor.fov_up, sensor.fov_down, sensor.up, sensor.origin)


def are_columns(names: tuple[str, ...]) -> bool:
    """Return whether names can name the columns of a table of points."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        return False
    used = [name for name in names if name != UNUSED_COLUMN]
    complete = not names or {"x", "y", "z"} <= set(used)
    plain = all(name == name.lower().strip() and name for name in names)
    return complete and plain and len(set(used)) == len(used) and len(names) <= MAX_COLUMNS


def is_field(name: object) -> bool:
    """Return whether a value can be the name of a column with the intensity."""
    reserved = ("x", "y", "z", UNUSED_COLUMN)
    return isinstance(name, str) and name == name.strip() and name not in reserved


def is_box(values: Any) -> bool:
    """Return whether values are the least and largest coordinates of a box, or none."""
    return values == () or (_are_within(values, count=6) and all(map(lt, values[:3], values[3:])))


def _are_within(
    values: Any, least: float = -MAX_NUMBER, most: float = MAX_NUMBER, *, count: int
) -> bool:
    """Return whether values are `count` numbers within bounds."""
    return are_numbers(values) and len(values) == count and all(least <= v <= most for v in values)


def _is_within(value: object, least: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> bool:
    return _are_within((value,), least, most, count=1)


def _are_quantiles(values: Any) -> bool:
    return _are_within(values, count=INTENSITY_LEVELS) and list(values) == sorted(values)


def _is_length(value: object) -> bool:
    return type(value) is int and value >= 1


def _is_direction(values: Any) -> bool:
    return _are_within(values, count=3) and math.hypot(values[0], values[1], values[2]) > MIN_LENGTH


FIELD_RULES = {
    "name": FieldRule(lambda name: isinstance(name, str), "a text"),
    "fov_up": FieldRule(_is_within, "a number of degrees"),
    "fov_down": FieldRule(_is_within, "a number of degrees"),
    "height": FieldRule(_is_length, "a number of pixels"),
    "width": FieldRule(_is_length, "a number of pixels"),
    "means": FieldRule(partial(_are_within, count=5), f"5 numbers up to {MAX_NUMBER:g}"),
    "stds": FieldRule(partial(_are_within, least=1 / MAX_NUMBER, count=5), f"5 numbers {SCALES}"),
    "out_of_view": FieldRule(lambda value: value in ("clamp", "drop"), "clamp or drop"),
    "intensity_scale": FieldRule(partial(_is_within, least=1 / MAX_NUMBER), f"a number {SCALES}"),
    "range_noise": FieldRule(partial(_is_within, least=0), "a deviation in metres"),
    "intensity_noise": FieldRule(partial(_is_within, least=0), "a deviation"),
    "columns": FieldRule(are_columns, COLUMNS_EXPECTED),
    "intensity_field": FieldRule(is_field, FIELD_EXPECTED),
    "up": FieldRule(_is_direction, "a direction, three numbers"),
    "origin": FieldRule(partial(_are_within, count=3), "a position, three numbers in metres"),
    "intensity_quantiles": FieldRule(_are_quantiles, f"{INTENSITY_LEVELS} increasing numbers"),
    "row_gaps": FieldRule(partial(_is_within, least=0, most=1), "a share"),
    "min_range": FieldRule(partial(_is_within, least=0), "a range in metres"),
    "ego_box": FieldRule(is_box, BOX_EXPECTED),
    "registered": FieldRule(lambda value: isinstance(value, bool), "true or false"),
    "traits": FieldRule(are_numbers, "numbers"),
    "others": FieldRule(lambda others: not any(s.others for s in others), "sensors without others"),
}
"""Possible values of each field of a sensor, its default aside."""


@cache
def presets() -> dict[str, Sensor]:
    """Return the built-in sensors by name."""
    text = resources.files("salsanext_cli").joinpath("presets/sensors.toml").read_text("utf-8")
    return {
        name: Sensor.from_dict({"name": name, **data}, name)
        for name, data in tomllib.loads(text).items()
    }
