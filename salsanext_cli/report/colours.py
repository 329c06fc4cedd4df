# SPDX-License-Identifier: MIT
"""Colours of labels and values, for pictures and point clouds, and scales of values."""

import math
from collections.abc import Iterable, Mapping, Sequence
from colorsys import hsv_to_rgb
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import did_you_mean
from salsanext_cli.core.wording import argument
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.results.folder_names import COLOURS
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import picture_columns
from salsanext_cli.runs.scans.scan_file import ScanFile

Colours = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float64]
Legend = Sequence[tuple[str, tuple[int, int, int]]]  # Names with their red, green, blue
Scale = tuple[float, ...]  # Two or more rising values at equal steps along the colour map
Scales = dict[str, Scale]  # Scales by colour
FIXED_SCALES: Scales = {"error": (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)}
"""Scales that are the same for every run: most errors are below 0.1."""

EMPTY = (36, 38, 45)  # Colour where there is no measurement
COLOUR_MAP = "viridis"  # Perceptually uniform
MIN_CONTRAST = 2.5  # Least ratio of luminances of a colour and `EMPTY`, as WCAG 2 defines it
ON_SCREEN = {
    (100, 150, 245): (83, 146, 255),  # car
    (80, 30, 180): (149, 137, 181),  # truck
    (255, 40, 200): (255, 89, 146),  # bicyclist
    (150, 30, 90): (162, 117, 113),  # motorcyclist
    (255, 120, 50): (245, 121, 6),  # fence
    (255, 240, 150): (255, 252, 186),  # pole
    (255, 0, 0): (255, 160, 143),  # traffic-sign
}
"""Replacements of SemanticKITTI's colours that look alike on a dark background."""
PALETTE = bytes.fromhex(
    "17c7fa 7b20ff fdaafe ffe5e8 03ffff c0cfff 7a8c6e 007325 "
    "c0ae94 05aca5 9d9b03 706517 ecffff 03e8a1 066f70 4361a5"
)
"""Colours for classes that have the colour of an earlier class, three bytes each."""
GOLDEN_RATIO = 0.618034  # Steps of this share of the circle of hues never meet
RIGHT = (92, 100, 112)
WRONG = (255, 72, 48)
"""Colours of points with a right and with a wrong label."""
NOT_JUDGED = (62, 76, 150)
"""Colour of points without a true label, or whose label was rejected, on a dark background."""
SCALE_PERCENTILES = (1.0, 99.0)  # Ends of a colour scale, which exclude outliers
SCANS_FOR_SCALE = 20  # Most scans whose values decide a common scale
OUTCOME_LEGEND = (("right", RIGHT), ("wrong", WRONG), ("not judged (no label)", NOT_JUDGED))
OUTCOMES = np.array((EMPTY, RIGHT, WRONG), np.uint8)  # Not judged, right and wrong
OUTCOMES_ON_DARK = np.array((NOT_JUDGED, RIGHT, WRONG), np.uint8)
CLASS_COLOURS = ("label", "truth", "wrong")


def value_range(values: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the 1st and the 99th percentile, the ends of a colour scale; (0, 1) without values."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, SCALE_PERCENTILES)
    return float(low), float(high)


def common_scales(
    out: Path, scans: Sequence[ScanFile], colours: Iterable[str], space: LabelSpace, sensor: Sensor
) -> Scales:
    """Return the scale of each colour of values, the same for all scans.

    Parameters
    ----------
    out : Path
        Output folder.
    scans : sequence of ScanFile
        Scans with results.
    colours : iterable of str
        Some of `PICTURE_COLOURS`; those of classes have no scale.
    space : LabelSpace
        Classes of the results.
    sensor : Sensor
        Sensor of the scans.

    Returns
    -------
    dict
        The fixed scale of a colour, or the range of its values over `SCANS_FOR_SCALE` scans.
        Colours without a value have none.
    """
    folder = ResultFolder(out)
    scales = dict[str, Scale]()
    values: dict[str, list[npt.NDArray[Any]]] = {}
    colours_of_scan: dict[ScanFile, list[str]] = {}  # Of the scans that are read
    for colour in colours:
        if colour in FIXED_SCALES:
            scales[colour] = FIXED_SCALES[colour]
        elif colour not in CLASS_COLOURS:
            values[colour] = [np.empty(0, np.float32)]
            with_values = folder.with_column(colour, scans)
            step = max(1, math.ceil(len(with_values) / SCANS_FOR_SCALE))
            for file in with_values[::step]:
                colours_of_scan.setdefault(file, []).append(colour)
    for file, colours_of_values in colours_of_scan.items():
        with suppress(SalsanextError):  # The run itself reports scans that cannot be read.
            columns = picture_columns(folder.read(file, sensor), space)
            for colour in colours_of_values:
                values[colour].append(columns[colour])
    for name, arrays in values.items():
        joined = np.concatenate(arrays)
        if np.isfinite(joined).any():
            scales[name] = value_range(joined)
    return scales


def require_colouring(
    colours: Iterable[str],
    scale: tuple[float, float] | None,
    name: str = "colour",
    *,
    possible: Sequence[str] = COLOURS,
) -> None:
    """Refuse an invalid scale, and colours of the argument `name` that are not possible."""
    for colour in colours:
        if colour not in possible:
            hint = did_you_mean(colour, possible)
            raise UsageError(argument(name), colour, f"one of {', '.join(possible)}", hint)
    if scale and not (scale[0] < scale[1] and all(map(math.isfinite, scale))):
        values = f"{scale[0]} {scale[1]}"
        raise UsageError(argument("scale"), values, "a lower and a higher number")


def on_dark(colours: npt.ArrayLike) -> Colours:
    """Mix colours (N, 3) with white until their contrast to `EMPTY` is `MIN_CONTRAST` or more."""
    white = np.linspace(0, 1, 256)[:, None, None]
    mixed = np.rint((1 - white) * np.asarray(colours) + white * 255)
    enough = _luminance(mixed) >= MIN_CONTRAST * _luminance(np.array(EMPTY))
    return mixed[enough.argmax(axis=0), np.arange(mixed.shape[1])].astype(np.uint8)


def _luminance(colours: npt.NDArray[Any]) -> Values:
    """Return the relative luminance of sRGB colours plus the 0.05 that WCAG 2 adds."""
    share = colours / 255
    linear = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    return linear @ (0.2126, 0.7152, 0.0722) + 0.05


def screen_colours(space: LabelSpace) -> Colours:
    """Return the colours of the classes in pictures, plots and pages, (C, 3) uint8.

    Dark colours of the label space are lightened. A class with the colour of an earlier class gets
    one of `PALETTE`, and after these one of evenly spread hues.
    """
    built_in = {*label_space().names, *label_space("coarse").names}
    replacements = ON_SCREEN if built_in.issuperset(space.names) else {}
    colours = [tuple(rgb) for rgb in space.colours.tolist()]
    preferred = [
        tuple(rgb) for rgb in on_dark([replacements.get(rgb, rgb) for rgb in colours]).tolist()
    ]
    unused = (rgb for rgb in _spare_colours() if rgb not in preferred)
    chosen: list[tuple[int, ...]] = []
    for rgb in preferred:
        chosen.append(next(unused) if rgb in chosen else rgb)
    return np.array(chosen, np.uint8).reshape(-1, 3)


@cache
def _spare_colours() -> tuple[tuple[int, ...], ...]:
    """Return different colours for a dark background: those of `PALETTE`, and then 1024 hues."""
    palette = np.frombuffer(PALETTE, np.uint8).reshape(-1, 3)
    hues = [hsv_to_rgb(GOLDEN_RATIO * n % 1, 0.3 + n % 3 * 0.3, 1.0) for n in range(1024)]
    colours = on_dark([*palette, *np.multiply(hues, 255)]).tolist()
    return tuple(dict.fromkeys(tuple(rgb) for rgb in colours))


@cache
def map_on_dark() -> Colours:
    """Return the 256 colours of `COLOUR_MAP`, dark ones lightened, (256, 3) uint8."""
    return on_dark(map_colours(COLOUR_MAP))


def value_colours(
    values: npt.NDArray[Any], *scale: float, colour_map: Colours | None = None
) -> Colours:
    """Return the colours of values along a colour map; NaN is `EMPTY`.

    Parameters
    ----------
    values : (…) array
        Values.
    *scale : float
        Rising values at equal steps along the map, two or more.
    colour_map : (256, 3) uint8, optional
        Colours; default: `map_on_dark`.

    Returns
    -------
    (…, 3) uint8
    """
    marks = scale if scale[-1] > scale[0] else (scale[0], scale[0] + 1)
    share = np.interp(values, marks, np.linspace(0, 1, len(marks)))
    position = np.rint(np.nan_to_num(share) * 255).astype(np.intp)
    colours = (map_on_dark() if colour_map is None else colour_map)[position]
    return np.where(np.isnan(share)[..., None], np.array(EMPTY, np.uint8), colours)


def map_colours(name: str) -> Colours:
    """Return the 256 colours of a matplotlib map, (256, 3) uint8."""
    import matplotlib

    return matplotlib.colormaps[name](np.arange(256), bytes=True)[:, :3]


def legend_of(space: LabelSpace, *labels: npt.NDArray[Any]) -> Legend:
    """Return the names of the classes in some labels, and their `screen_colours`."""
    present = np.unique(np.concatenate([train.ravel() for train in labels]))
    colours = screen_colours(space)[present].tolist()
    return [(space.names[i], (*rgb,)) for i, rgb in zip(present, colours, strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PointColours:
    """Colouring of points, the same for all scans of a run."""

    colour: str  # One of `PICTURE_COLOURS` except "uncertainty"
    scale: Scale  # Of colours that are values
    space: LabelSpace  # Colours of the classes
    dark: bool = False  # Whether the background is `EMPTY`, unlike in files for other tools

    @property
    def legend(self) -> str:
        """Meaning of the colours, on one line."""
        if self.colour in CLASS_COLOURS:
            return self.colour
        return " ".join((self.colour, COLOUR_MAP, *(f"{mark:.6g}" for mark in self.scale)))

    def rgb(self, columns: Mapping[str, npt.NDArray[Any]]) -> Colours:
        """Return red, green and blue of every point, (N, 3), from its `picture_columns`."""
        if self.colour not in CLASS_COLOURS:
            colour_map = None if self.dark else map_colours(COLOUR_MAP)
            return value_colours(columns[self.colour], *self.scale, colour_map=colour_map)
        if self.colour == "wrong":
            outcomes = OUTCOMES_ON_DARK if self.dark else OUTCOMES
            return outcomes[np.nan_to_num(columns["wrong"] + 1).astype(np.intp)]
        class_colours = screen_colours(self.space) if self.dark else self.space.colours
        return class_colours[self.space.to_train(columns[self.colour], strict=False)]
