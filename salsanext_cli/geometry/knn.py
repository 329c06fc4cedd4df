# SPDX-License-Identifier: MIT
"""Labels of pixels to labels of points by their nearest neighbours in range (RangeNet++).

The candidates of a point are the pixels of a window around its own. A candidate's distance is
``|range of the candidate − range of the point| × (1 − Gaussian of its offset)``; the point's own
pixel stands for the point itself, at distance 0. The k nearest whose distance does not exceed the
cutoff vote with their labels; label 0 takes a place but has no vote; the lowest label wins ties.

The window goes on around the image in azimuth. Pixels that are empty or above or below the image
are no candidates, and a point without a vote keeps its pixel's label.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import TrainIds
from salsanext_cli.errors import LabelError, UsageError
from salsanext_cli.geometry.knn_parameters import KnnParameters
from salsanext_cli.records import RangeImage

__all__ = ["KnnParameters", "knn_refine"]

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
