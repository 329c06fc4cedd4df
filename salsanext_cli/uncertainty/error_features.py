# SPDX-License-Identifier: MIT
"""Features of a point that tell how likely its label is wrong, from a single pass of the network.

They hold no class, so that they mean the same for any classes. Intensity is left out, since it
differs from sensor to sensor and told nothing more.
"""

import numpy as np

from salsanext_cli.classes import TrainIds
from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.geometry.window_agreement import window_agreement
from salsanext_cli.inference.network import Network
from salsanext_cli.network.error_model import ErrorModel
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.uncertainty.estimate import entropy

FEATURES = (
    "probability of the label",
    "largest probability",
    "margin to the second largest",
    "entropy",
    "log range",
    "height above the sensor",
    "log range beyond that of the pixel",
    "pixels of the label in the window",
    "spread of the log range in the window",
    "occupied pixels of the window",
    "mean probability of the label in the window",
)
NEAREST_M = 0.5
"""Ranges are no less in logarithms."""


def error_features(image: RangeImage, probabilities: Float, labels: TrainIds) -> Float:
    """Return the features of every point, (N, 11) float32; NaN where it has no pixel.

    Parameters
    ----------
    image : RangeImage
        Of the scan.
    probabilities : (C, H, W) float32
        Softmax of a single pass.
    labels : (N,) uint8
        Train ids of the points, after kNN.
    """
    found = np.full((len(labels), len(FEATURES)), np.nan, np.float32)
    points = np.flatnonzero(image.pixel_of_point >= 0)
    pixels = image.pixel_of_point[points]
    of_pixels = probabilities.reshape(len(probabilities), -1)
    # Sorted once per pixel: several points may lie in one.
    largest = np.partition(of_pixels, -2, axis=0)[-2:]
    log_range = np.log(np.maximum(image.channels[0], NEAREST_M))
    own = np.log(np.maximum(image.point_range[points], NEAREST_M))
    found[points, 0] = of_pixels[labels[points], pixels]
    found[points, 1] = largest[1, pixels]
    found[points, 2] = (largest[1] - largest[0])[pixels]
    found[points, 3] = entropy(of_pixels)[pixels]
    found[points, 4] = own
    found[points, 5] = image.channels[3].reshape(-1)[pixels]
    found[points, 6] = own - log_range.reshape(-1)[pixels]
    found[points, 7:] = window_agreement(image, log_range, probabilities, labels[points], pixels)
    return found


def knows_error(network: Network) -> bool:
    """Say whether weights have a model of errors by these features for the classes of results."""
    model = network.card.error
    return model is not None and model.features == FEATURES and network.merging is None


def error_model(network: Network) -> ErrorModel:
    """Return the model of errors of weights.

    Raises
    ------
    WeightsError
        If they have none, or one of other features.
    UsageError
        If classes are merged: the model is of the labels before.
    """
    model = network.card.error
    if model is None:
        remedy = "`salsanext tune error DATASET WEIGHTS_OUT` fits one to labelled scans"
        raise WeightsError(network.weights, "no probability of errors", "weights with one", remedy)
    if model.features != FEATURES:
        raise WeightsError(network.weights, "errors by other features", ", ".join(FEATURES))
    if network.merging is not None:
        found = "the probability of errors is of labels before merging"
        raise UsageError("--classes", found, "the classes of the weights")
    return model


def label_error(
    network: Network, image: RangeImage, probabilities: Float, labels: TrainIds
) -> Float:
    """Return the probability that a point's label is wrong, (N,) float32, NaN without a pixel.

    Parameters are those of `error_features`; it raises what `error_model` does.
    """
    return error_model(network).probability(error_features(image, probabilities, labels))
