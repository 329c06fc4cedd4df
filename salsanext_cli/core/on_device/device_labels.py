# SPDX-License-Identifier: MIT
"""Results of one scan that a device has labelled."""

from dataclasses import dataclass

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.records import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceLabels:
    """Results of one scan of N points, copied from a device.

    Attributes
    ----------
    labels : (N,) uint8
        Train ids, refined by kNN.
    least_confidence : (N,) float32
        1 minus the largest probability of the pixel of each point; NaN without a pixel.
    pixel_labels : (H, W) uint8
        Train ids of the pixels.
    mean_confidence : float
        Mean of the largest probabilities of the occupied pixels; 1 without any.
    is_finite : bool
        Whether all largest probabilities are finite.
    ego_points : int
        Number of points on the sensor or its vehicle.
    is_final : bool
        Whether more rounds would change no error.
    softmax : (N, C) float32 or float16, optional
        Probabilities of all classes.
    error : (N,) float32, optional
        Probability that each label is wrong; NaN without a pixel.
    """

    labels: TrainIds
    least_confidence: Float
    pixel_labels: TrainIds
    mean_confidence: float
    is_finite: bool
    ego_points: int
    is_final: bool = True
    softmax: Float | None = None
    error: Float | None = None
