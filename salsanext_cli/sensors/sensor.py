# SPDX-License-Identifier: MIT
"""Sensors: the geometry of their range images and how these are normalised."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from salsanext_cli.errors import UsageError, error_text, quoted, shortened
from salsanext_cli.files.yaml_toml import are_numbers, read_toml, refuse_unknown
from salsanext_cli.sensors.limits import NOISE, faults

SEMANTIC_KITTI_MEANS = (12.12, 10.88, 0.23, -1.04, 0.21)
SEMANTIC_KITTI_STDS = (12.32, 11.47, 6.91, 0.86, 0.16)
NO_VIEW = ("name", *NOISE, "intensity_quantiles", "row_gaps")
OF_IMAGES = ("height", "width", "means", "stds")
"""Fields that a network depends on, not a sensor: size and normalisation of its images."""
OF_DEVICE = ("name", "intensity_scale", *NOISE)
"""Fields of a built-in sensor that hold whatever the range images of a network are."""
UP = (0.0, 0.0, 1.0)
"""Direction of the z axis, away from the ground."""
ORIGIN = (0.0, 0.0, 0.0)
FITTED_NAME = "fitted"
"""Name of a sensor whose view or mounting was found from scans."""
OPTIONAL = {
    "columns": (),
    "up": UP,
    "origin": ORIGIN,
    "intensity_quantiles": (),
    "beams": (),
    "row_gaps": None,
    "min_range": None,
    "ego_box": None,
}
"""Defaults of fields that are written only where a sensor has another value."""
NUMBERS = ("fov_up", "fov_down", "height", "width", "intensity_scale")
LISTS = ("means", "stds")


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
    beams : tuple of float
        Elevations of its beams in degrees from top to bottom, which then are spread over the rows
        of the range image; empty for rows by elevation.
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
    beams: tuple[float, ...] = ()
    row_gaps: float | None = None
    min_range: float | None = None
    ego_box: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for found, expected in faults(
            {field.name: getattr(self, field.name) for field in fields(self)}
        ):
            raise UsageError(f"sensor {shortened(self.name)}", found, expected)

    @property
    def knows_noise(self) -> bool:
        """True if both noises are known."""
        return self.range_noise is not None and self.intensity_noise is not None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts, without the defaults of `OPTIONAL`."""
        values = asdict(self)
        usual = [key for key, default in OPTIONAL.items() if values[key] == default]
        return {key: value for key, value in values.items() if key not in usual}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "sensor") -> Sensor:
        """Build a sensor from plain data; an unknown or missing key raises `UsageError`."""
        refuse_unknown(data, cls, source)
        expected = "a sensor with fov_up, fov_down, height, width"
        if missing := [f.name for f in fields(cls) if f.default is MISSING and f.name not in data]:
            remedy = "`salsanext inspect SCANS --fit FILE.toml` finds the view of scans"
            raise UsageError(source, f"lacks {', '.join(missing)}", expected, remedy)
        for key in (*NUMBERS, *LISTS, *(noise for noise in NOISE if data.get(noise) is not None)):
            several = key in LISTS
            if key in data and not are_numbers(data[key] if several else [data[key]]):
                wanted = "5 numbers" if several else "a number"
                raise UsageError(source, f"{key} is {quoted(data[key])}", wanted)
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in data.items()
        }
        try:
            return cls(**values)
        except (TypeError, OverflowError) as error:
            raise UsageError(source, error_text(error), expected) from error

    def to_toml(self, *, images: bool = True) -> str:
        """Return the text of a TOML file that `sensor` reads; the file's name is the sensor's.

        Without `images`, size and normalisation are left out, so that they are those of the
        weights that the file is used with.
        """
        left_out = ("name",) if images else ("name", *OF_IMAGES)
        values = {key: value for key, value in self.to_dict().items() if key not in left_out}
        # What JSON writes for texts, numbers and lists of numbers is TOML as well.
        known = {key: value for key, value in values.items() if value is not None}
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in known.items())

    def view(self) -> dict[str, Any]:
        """Return plain data of the view of a network: all but name, noise and measured shares."""
        return {key: value for key, value in self.to_dict().items() if key not in NO_VIEW}

    def resized(self, height: int | None = None, width: int | None = None) -> Sensor:
        """Return the same sensor with another image size."""
        return replace(
            self,
            height=self.height if height is None else height,
            width=self.width if width is None else width,
        )


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

    Size and normalisation that the file does not tell are those of `base`, else of the HDL-64; then
    beams count only where those of `base` do.

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
    found = Sensor.from_dict({"name": path.stem, **images, **data}, path)
    by_beams = base is None or base.beams or not data.keys().isdisjoint(("height", "width"))
    return found if by_beams else replace(found, beams=())
