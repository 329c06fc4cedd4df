# SPDX-License-Identifier: MIT
"""Labels of pixels to labels of points by their nearest neighbours in range (RangeNet++).

The candidates of a point are the pixels of a window around its own. A candidate's distance is
``|range of the candidate − range of the point| × (1 − Gaussian of its offset)``; the point's own
pixel stands for the point itself, at distance 0. The k nearest whose distance does not exceed the
cutoff vote with their labels; label 0 takes a place but has no vote; the lowest label wins ties.

The window goes on around the image in azimuth. Pixels that are empty or above or below the image
are no candidates, and a point without a vote keeps its pixel's label.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.errors import LabelError, UsageError
from salsanext_cli.records import Float, Int, RangeImage

Scalar = TypeVar("Scalar", bound=np.generic)

LARGEST_WINDOW_PX = 63
"""Largest side of the window in pixels."""


@dataclass(frozen=True, slots=True)
class KnnParameters:
    """Settings of the neighbourhood and of the vote; the defaults are the published ones.

    Attributes
    ----------
    k : int
        Number of nearest neighbours that may vote, the point's own pixel included.
    window : int
        Odd side of the window in pixels.
    sigma : float
        Standard deviation of the Gaussian in pixels.
    cutoff : float
        Maximum range difference of a neighbour, in metres.
    """

    k: int = 5
    window: int = 5
    sigma: float = 1.0
    cutoff: float = 1.0

    def __post_init__(self) -> None:
        window, k = self.window, self.k
        possible = {
            "window": 1 <= window <= LARGEST_WINDOW_PX and window % 2 == 1,
            "k": 1 <= k <= window**2,
            "sigma": 0 < self.sigma < math.inf,
            "cutoff": self.cutoff >= 0,
        }
        expected = {
            "window": f"an odd window from 1 to {LARGEST_WINDOW_PX}",
            "k": f"1 ≤ k ≤ {window**2} neighbours in a window of {window}",
            "sigma": "a finite sigma above 0 pixels",
            "cutoff": "a cutoff ≥ 0 metres",
        }
        for name, holds in possible.items():
            if not holds:
                raise UsageError("knn", f"{name} {getattr(self, name)}", expected[name])

    def candidates(self, width: int) -> tuple[Int, Float]:
        """Return the offsets of a point's candidates and the factors of their distances.

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
            Their factors, 1 − Gaussian.
        """
        half = self.window // 2
        dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
        kept = (dx >= -((width - 1) // 2)) & (dx <= width // 2) & ((dx != 0) | (dy != 0))
        offsets = dy * (width + 2 * half) + dx
        gaussian = np.exp(-(dy**2 + dx**2) / (2 * self.sigma**2))
        weights = 1 - gaussian / gaussian.sum()
        return offsets[kept].astype(np.int32), weights[kept].astype(np.float32)


def knn_refine(
    image: RangeImage,
    pixel_labels: npt.ArrayLike,
    class_count: int = 20,
    parameters: KnnParameters = KnnParameters(),
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
    half, width = parameters.window // 2, image.width
    empty = image.channels[0] <= 0
    ranges = _framed(np.where(empty, np.float32(np.inf), image.channels[0]), half, np.inf)
    framed_labels = _framed(np.where(empty, np.uint8(0), labels), half, 0)
    points = (image.pixel_of_point, image.point_range)
    candidates = parameters.candidates(width)
    votes = (parameters.k, parameters.cutoff)
    if device == "cpu":
        from salsanext_cli.geometry import knn_numba

        return knn_numba.refine(*points, ranges, framed_labels, width, half, *candidates, *votes)
    from salsanext_cli.geometry import knn_torch

    return knn_torch.refine(
        *points, ranges, framed_labels, width, half, *candidates, *votes, device=device
    )


def _framed(image: npt.NDArray[Scalar], half: int, beyond: float) -> npt.NDArray[Scalar]:
    """Return the flattened image with a frame of `half` pixels, periodic in azimuth."""
    wide = np.pad(image, ((0, 0), (half, half)), mode="wrap")
    return np.pad(wide, ((half, half), (0, 0)), constant_values=beyond).reshape(-1)


def _checked_labels(image: RangeImage, labels: npt.NDArray[np.generic], count: int) -> TrainIds:
    """Return uint8 labels that fit the image; neither kernel checks bounds."""
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
    return labels.astype(np.uint8, copy=False)
