# SPDX-License-Identifier: MIT
"""Range images as pictures: one colour per pixel, by label, error or value."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.records import RangeImage
from salsanext_cli.report.colours import (
    EMPTY,
    Colours,
    error_colours,
    label_colours,
    value_colours,
)


def on_pixels(image: RangeImage, of_points: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the value of the point that each pixel shows.

    Parameters
    ----------
    image : RangeImage
        Holds the point that each pixel shows.
    of_points : (N, …) array
        A value per point.

    Returns
    -------
    (H, W, …) array
        Of the same dtype, 0 where empty.
    """
    filled = image.point_of_pixel >= 0
    pixels = np.zeros((*filled.shape, *of_points.shape[1:]), of_points.dtype)
    pixels[filled] = of_points[image.point_of_pixel[filled]]
    return pixels


def label_picture(image: RangeImage, train: npt.NDArray[Any], space: LabelSpace) -> Colours:
    """Colour a range image by the labels of its points.

    Parameters
    ----------
    image : RangeImage
        The image.
    train : (N,) integer
        Train id of every point.
    space : LabelSpace
        Whose colours to take.

    Returns
    -------
    (H, W, 3) uint8
        Red, green, blue; `EMPTY` where there is no point.
    """
    return _on_empty(image, label_colours(on_pixels(image, train), space))


def error_picture(
    image: RangeImage, truth: npt.NDArray[Any], predicted: npt.NDArray[Any], space: LabelSpace
) -> Colours:
    """Colour a range image by whether the prediction is right; parameters as `label_picture`."""
    colours = error_colours(on_pixels(image, truth), on_pixels(image, predicted), space)
    return _on_empty(image, colours)


def scalar_picture(image: RangeImage, values: npt.NDArray[Any], low: float, high: float) -> Colours:
    """Colour a range image by values of its pixels.

    Parameters
    ----------
    image : RangeImage
        The image.
    values : (H, W) float
        What to show.
    low, high : float
        The values at the two ends of the scale.

    Returns
    -------
    (H, W, 3) uint8
        Red, green, blue; `EMPTY` where there is no point or no number.
    """
    return _on_empty(image, value_colours(values, low, high))


def _on_empty(image: RangeImage, colours: Colours) -> Colours:
    return np.where(image.point_of_pixel[..., None] >= 0, colours, np.array(EMPTY, np.uint8))
