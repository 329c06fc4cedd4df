# SPDX-License-Identifier: MIT
"""Colours of labels and values, for pictures and point clouds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.storage.layout import COLOURINGS

Colours = npt.NDArray[np.uint8]
Legend = Sequence[tuple[str, tuple[int, int, int]]]
"""Names with their red, green, blue."""

EMPTY = (36, 38, 45)
"""Colour of a place without a measurement."""
COLOUR_MAP = "viridis"
"""Name of matplotlib's colour map for values; it is perceptually uniform."""
LEAST_CONTRAST = 2.5
"""Least ratio of luminances of a colour and `EMPTY` in pictures, as WCAG 2 defines it."""
RIGHT = (92, 100, 112)
WRONG = (255, 72, 48)
"""Colours of points with a right and with a wrong label."""
SCALE_PERCENTILES = (1.0, 99.0)
"""Ends of a colour scale by default, which leave out a few outliers."""
OUTCOME_LEGEND = (("right", RIGHT), ("wrong", WRONG))
OUTCOMES = np.array((EMPTY, RIGHT, WRONG), np.uint8)
"""Colours of points that are not judged, right and wrong, (3, 3)."""
CLASS_COLOURS = ("label", "truth", "wrong")
COLOURS = (*COLOURINGS, "uncertainty")
"""Colourings of points; "uncertainty" is the error, else the entropy."""


def error_colours(
    truth: npt.NDArray[Any], predicted: npt.NDArray[Any], space: LabelSpace
) -> Colours:
    """Return `RIGHT`, `WRONG`, or `EMPTY` where the truth is ignored.

    Parameters
    ----------
    truth, predicted : integer, same shape
        Train ids.
    space : LabelSpace
        Label space with the ignored classes.

    Returns
    -------
    (…, 3) uint8
        Red, green, blue.
    """
    place = np.where(space.scored[truth], 1 + (truth != predicted), 0)
    colours: Colours = OUTCOMES[place]
    return colours


def value_range(values: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the lowest and highest value that a colour scale should span.

    Parameters
    ----------
    values : float, any shape
        Values to colour; NaN and infinity are left out.

    Returns
    -------
    tuple of float
        The 1st and the 99th percentile; (0, 1) without values.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, SCALE_PERCENTILES)
    return float(low), float(high)


def on_dark(colours: npt.ArrayLike) -> Colours:
    """Mix colours with white that are too dark to be seen on `EMPTY`; leave the others.

    Parameters
    ----------
    colours : (N, 3) uint8
        Red, green, blue.

    Returns
    -------
    (N, 3) uint8
        With a contrast to `EMPTY` of `LEAST_CONTRAST` or more.
    """
    white = np.linspace(0, 1, 256)[:, None, None]
    mixed = np.rint((1 - white) * np.asarray(colours) + white * 255)
    enough = _luminance(mixed) >= LEAST_CONTRAST * _luminance(np.array(EMPTY))
    found: Colours = mixed[enough.argmax(axis=0), np.arange(mixed.shape[1])].astype(np.uint8)
    return found


def _luminance(colours: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return the relative luminance of sRGB, to which WCAG 2 adds the light of a room."""
    share = colours / 255
    linear = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    luminance: npt.NDArray[np.float64] = linear @ np.array((0.2126, 0.7152, 0.0722)) + 0.05
    return luminance


@cache
def map_on_dark() -> Colours:
    """Return the 256 colours of `COLOUR_MAP` as pictures have them, (256, 3) uint8."""
    return on_dark(map_colours(COLOUR_MAP))


def value_colours(
    values: npt.NDArray[Any], low: float, high: float, colour_map: Colours | None = None
) -> Colours:
    """Colour values by a perceptually uniform map.

    Parameters
    ----------
    values : float, any shape
        Values; those beyond the scale get the colour of its end, NaN gets `EMPTY`.
    low, high : float
        The values at the two ends of the scale.
    colour_map : (256, 3) uint8, optional
        Otherwise `map_on_dark`, that of pictures.

    Returns
    -------
    (…, 3) uint8
        Red, green, blue.
    """
    span = high - low if high > low else 1.0
    share = np.clip((values.astype(np.float64) - low) / span, 0, 1)
    position = np.rint(np.nan_to_num(share) * 255).astype(np.intp)
    colours = (map_on_dark() if colour_map is None else colour_map)[position]
    return np.where(np.isnan(share)[..., None], np.array(EMPTY, np.uint8), colours)


def map_colours(name: str) -> Colours:
    """Return the 256 colours of a matplotlib map, (256, 3) uint8."""
    import matplotlib

    colours: Colours = matplotlib.colormaps[name](np.arange(256), bytes=True)[:, :3]
    return colours


def legend_of(space: LabelSpace, *labels: npt.NDArray[Any]) -> Legend:
    """Return names and colours, as pictures have them, of the classes that occur."""
    present = np.unique(np.concatenate([train.ravel() for train in labels]))
    colours = on_dark(space.colours)[present].tolist()
    return [(space.names[i], (*rgb,)) for i, rgb in zip(present, colours, strict=True)]


@dataclass(frozen=True, slots=True)
class PointColours:
    """Colouring of points, the same for all scans of a run.

    Attributes
    ----------
    colour : str
        One of `COLOURS`, "uncertainty" aside.
    scale : pair of float
        Values at the ends of the colour map, for colours that are values.
    space : LabelSpace
        Colours of the classes.
    dark : bool
        Whether they are seen on `EMPTY`, in a picture, where dark ones are lightened.
    """

    colour: str
    scale: tuple[float, float]
    space: LabelSpace
    dark: bool = False

    @property
    def is_class(self) -> bool:
        """True if points are coloured by class, without a scale."""
        return self.colour in CLASS_COLOURS

    @property
    def legend(self) -> str:
        """One line with the meaning of the colours."""
        low, high = self.scale
        return self.colour if self.is_class else f"{self.colour} {COLOUR_MAP} {low:.6g} {high:.6g}"

    def of_points(self, columns: Mapping[str, npt.NDArray[Any]]) -> Colours:
        """Return red, green and blue of every point, (N, 3), from its `scalar_columns`."""
        colours: Colours
        if not self.is_class:
            of_files = None if self.dark else map_colours(COLOUR_MAP)
            return value_colours(columns[self.colour], *self.scale, of_files)
        if self.colour == "wrong":
            colours = OUTCOMES[np.nan_to_num(columns["wrong"] + 1).astype(np.intp)]
            return colours
        of_classes = on_dark(self.space.colours) if self.dark else self.space.colours
        colours = of_classes[self.space.to_train(columns[self.colour], strict=False)]
        return colours
