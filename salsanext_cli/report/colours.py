# SPDX-License-Identifier: MIT
"""Colours of labels and values, for pictures and point clouds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
RIGHT = (92, 100, 112)
WRONG = (255, 72, 48)
"""Colours of points with a right and with a wrong label."""
SCALE_PERCENTILES = (1.0, 99.0)
"""Ends of a colour scale by default, which leave out a few outliers."""
OUTCOMES = np.array((EMPTY, RIGHT, WRONG), np.uint8)
"""Colours of points that are not judged, right and wrong, (3, 3)."""
LUMA = np.array((0.2126, 0.7152, 0.0722))
"""Weights of red, green and blue in how bright a colour looks."""
LEAST_LUMA = 80.0
"""Of 255; the background of a view has 23."""
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


def value_colours(values: npt.NDArray[Any], low: float, high: float) -> Colours:
    """Colour values by a perceptually uniform map.

    Parameters
    ----------
    values : float, any shape
        Values; those beyond the scale get the colour of its end, NaN gets `EMPTY`.
    low, high : float
        The values at the two ends of the scale.

    Returns
    -------
    (…, 3) uint8
        Red, green, blue.
    """
    span = high - low if high > low else 1.0
    share = np.clip((values.astype(np.float64) - low) / span, 0, 1)
    position = np.rint(np.nan_to_num(share) * 255).astype(np.intp)
    colours = map_colours(COLOUR_MAP)[position]
    return np.where(np.isnan(share)[..., None], np.array(EMPTY, np.uint8), colours)


def map_colours(name: str) -> Colours:
    """Return the 256 colours of a matplotlib map, (256, 3) uint8."""
    import matplotlib

    colours: Colours = matplotlib.colormaps[name](np.arange(256), bytes=True)[:, :3]
    return colours


def on_dark(colours: Colours) -> Colours:
    """Mix colours (…, 3) that can hardly be seen on a dark background with white.

    Their luma becomes `LEAST_LUMA` at least. Brighter ones with the same hue would be the colours
    of other classes: the sidewalk's would be that of the road.
    """
    luma = colours @ LUMA
    white = np.clip((LEAST_LUMA - luma) / (255 - luma).clip(1), 0, 1)[..., None]
    lightened: Colours = np.rint(colours + white * (255.0 - colours)).astype(np.uint8)
    return lightened


def legend_of(space: LabelSpace, *labels: npt.NDArray[Any], errors: bool = False) -> Legend:
    """Return names and colours of the classes that occur, and of errors on request."""
    present = np.unique(np.concatenate([train.ravel() for train in labels]))
    classes = [(space.names[i], space.colours[i]) for i in present]
    legend = [(name, (int(red), int(green), int(blue))) for name, (red, green, blue) in classes]
    return [*legend, ("right", RIGHT), ("wrong", WRONG)] if errors else legend


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
    """

    colour: str
    scale: tuple[float, float]
    space: LabelSpace

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
            return value_colours(columns[self.colour], *self.scale)
        if self.colour == "wrong":
            colours = OUTCOMES[np.nan_to_num(columns["wrong"] + 1).astype(np.intp)]
            return colours
        colours = self.space.colours[self.space.to_train(columns[self.colour], strict=False)]
        return colours
