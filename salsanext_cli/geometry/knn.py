# SPDX-License-Identifier: MIT
"""Labels of pixels to labels of points by their nearest neighbours in range (RangeNet++).

The candidates of a point are the pixels of a window around its own. A candidate's distance is
``|range of the candidate − range of the point| × (1 − Gaussian of its offset)``; the point's own
pixel stands for the point itself, at distance 0. The k nearest whose distance does not exceed the
cutoff vote with their labels; label 0 takes a place but has no vote; the lowest label wins ties.

The window goes on around the image in azimuth. Pixels that are empty or above or below the image
are no candidates, and a point for which nobody votes keeps its pixel's label.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import TrainIds
from salsanext_cli.errors import LabelError, UsageError
from salsanext_cli.records import Float, Int, RangeImage

LARGEST_WINDOW = 63
"""Pixels; farther ones are no neighbours."""


@dataclass(frozen=True, slots=True)
class KnnParameters:
    """How neighbours are found and weighed; the defaults are the published ones.

    Attributes
    ----------
    k : int
        How many nearest neighbours may vote, the point's own pixel included.
    window : int
        Odd side of the window in pixels.
    sigma : float
        Standard deviation of the Gaussian in pixels.
    cutoff : float
        Largest distance of a voter in metres.
    """

    k: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff: float = 1.0

    def __post_init__(self) -> None:
        self._require(
            1 <= self.window <= LARGEST_WINDOW and self.window % 2 == 1,
            f"window {self.window}",
            f"an odd window from 1 to {LARGEST_WINDOW}",
        )
        self._require(
            1 <= self.k <= self.window**2,
            f"k {self.k}",
            f"1 ≤ k ≤ {self.window**2} neighbours in a window of {self.window}",
        )
        self._require(
            0 < self.sigma < math.inf, f"sigma {self.sigma}", "a finite sigma above 0 pixels"
        )
        self._require(self.cutoff >= 0, f"cutoff {self.cutoff}", "a cutoff ≥ 0 metres")

    def _require(self, holds: bool, found: str, expected: str) -> None:
        if not holds:
            raise UsageError("knn", found, expected)

    def weights(self) -> Float:
        """Return 1 − Gaussian of each offset in the window, (window, window) float32."""
        offset = np.arange(self.window) - self.window // 2
        gaussian = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * self.sigma**2))
        return np.asarray(1 - gaussian / gaussian.sum(), np.float32)

    def candidates(self, width: int) -> tuple[Int, Float]:
        """Return where a point's candidates lie and what weighs their distance, row by row.

        Parameters
        ----------
        width : int
            W of the range image. If it is narrower than the window, no pixel comes round twice.

        Returns
        -------
        offsets : (M,) int32
            Flat offsets from the point's pixel, itself left out, in an image that is framed by
            ``window // 2`` pixels on each side.
        weights : (M,) float32
            Their factors.
        """
        half = self.window // 2
        dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
        kept = (dx >= -((width - 1) // 2)) & (dx <= width // 2) & ((dx != 0) | (dy != 0))
        offsets = dy * (width + 2 * half) + dx
        return offsets[kept].astype(np.int32), self.weights()[kept]


PUBLISHED = KnnParameters()


def knn_refine(
    image: RangeImage,
    pixel_labels: npt.ArrayLike,
    class_count: int = 20,
    parameters: KnnParameters = PUBLISHED,
    device: str = "cpu",
) -> TrainIds:
    """Give every point a label by a vote of its nearest neighbours in the range image.

    Parameters
    ----------
    image : RangeImage
        The scan's projection.
    pixel_labels : (H, W) integers
        Train id of every pixel, 0 … C − 1; of empty pixels too, but those are not used.
    class_count : int
        C, the number of classes including the unlabelled class 0.
    parameters : KnnParameters
        Neighbourhood; the published one by default.
    device : str
        "cpu" (compiled by numba) or a torch device; the labels are the same.

    Returns
    -------
    (N,) uint8
        Train id of every point; 0 where a point has no pixel.

    Raises
    ------
    LabelError
        If the labels have another shape than the image or are no train ids.
    """
    labels = _checked_labels(image, np.asarray(pixel_labels), class_count)
    ranges = np.ascontiguousarray(image.channels[0])
    arguments = (ranges, labels, image.pixel_of_point, image.point_range, parameters)
    if device == "cpu":
        from salsanext_cli.geometry import knn_numba

        return knn_numba.refine(*arguments)
    from salsanext_cli.geometry import knn_torch

    return knn_torch.refine(*arguments, device)


def _checked_labels(image: RangeImage, labels: npt.NDArray[np.generic], count: int) -> TrainIds:
    """Return contiguous uint8 labels that fit the image; neither kernel checks bounds."""
    if not 1 <= count <= 256:
        raise UsageError("knn", f"{count} classes", "1 to 256 classes")
    if labels.shape != (image.height, image.width):
        raise LabelError(
            "pixel labels", f"shape {labels.shape}", f"({image.height}, {image.width})"
        )
    if not np.issubdtype(labels.dtype, np.integer):
        raise LabelError("pixel labels", f"dtype {labels.dtype}", "integer train ids")
    if labels.min() < 0 or labels.max() >= count:
        raise LabelError("pixel labels", f"{labels.min()} … {labels.max()}", f"0 … {count - 1}")
    pixels = image.pixel_of_point
    if len(pixels) and (pixels.min() < -1 or pixels.max() >= labels.size):
        raise LabelError(
            "pixels of points", f"{pixels.min()} … {pixels.max()}", f"-1 … {labels.size - 1}"
        )
    return np.ascontiguousarray(labels, np.uint8)
