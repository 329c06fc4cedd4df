# SPDX-License-Identifier: MIT
"""Features of a point that tell how likely its label is wrong, from a single pass of the network.

They hold no class, so that they mean the same for any classes. All but the height mean the same
for any sensor.
"""

import numpy as np

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.compiled.kernels import parallel_for_slices
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.geometry.label_support import label_support, region_means
from salsanext_cli.network.error_model import ErrorModel
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.uncertainty.estimate import entropy

FEATURES = (
    "probability of the label",
    "largest probability",
    "margin to the second largest",
    "entropy",
    "mean probability of the label around",
    "mean largest probability of the region",
    "log range beyond that of the pixel",
    "log range",
    "height above the sensor",
)
NEAREST_M = 0.5
"""Ranges are no less in logarithms."""


def error_features(image: RangeImage, probabilities: Float, labels: TrainIds) -> Float:
    """Return the features of every point, (N, 9) float32; NaN where it has no pixel.

    `image`: of the scan; `probabilities` (C, H, W) float32, softmax of a single pass; `labels` (N,)
    uint8, train ids of the points, after kNN.
    """
    # Most points have the label of their pixel: described once per pixel, the others on their own.
    classes, table = _of_pixels(image, probabilities)
    found = np.empty((len(labels), len(FEATURES)), np.float32)
    differs = np.empty(len(labels), bool)

    def gather(part: slice) -> None:
        pixels, log_range = image.pixel_of_point[part], _log_range(image.point_range[part])
        table.take(pixels, 0, found[part], "clip")
        found[part, 6] = log_range - found[part, 7]
        found[part, 7] = log_range
        differs[part] = labels[part] != classes.take(pixels, mode="clip")

    parallel_for_slices(gather, len(labels))
    other = np.flatnonzero(differs & (image.pixel_of_point >= 0))
    own, pixels = labels[other], image.pixel_of_point[other]
    found[other, 0] = probabilities.reshape(len(probabilities), -1)[own, pixels]
    found[other, 4] = label_support(image, probabilities, own, pixels)
    found[image.pixel_of_point < 0] = np.nan
    return found


def _of_pixels(image: RangeImage, probabilities: Float) -> tuple[TrainIds, Float]:
    """Return the class of each pixel, (H · W,), and its features, (H · W, 9) float32.

    They are those of its nearest point, if that has this class; how far it lies beyond is 0.
    """
    largest, second = np.zeros((2, *probabilities.shape[1:]), np.float32)
    classes = np.zeros(largest.shape, np.uint8)
    for train_id, each in enumerate(probabilities):
        np.copyto(classes, train_id, where=each > largest)
        np.maximum(second, np.minimum(largest, each), out=second)
        np.maximum(largest, each, out=largest)
    table = np.zeros((classes.size, len(FEATURES)), np.float32)
    table[:, 0] = table[:, 1] = largest.reshape(-1)
    table[:, 2] = (largest - second).reshape(-1)
    table[:, 3] = entropy(probabilities).reshape(-1)
    occupied = np.flatnonzero(image.channels[0] > 0).astype(np.int32)
    of_pixel = classes.reshape(-1)[occupied]
    table[occupied, 4] = label_support(image, probabilities, of_pixel, occupied)
    table[:, 5] = region_means(image, classes, largest).reshape(-1)
    table[:, 7] = _log_range(image.channels[0]).reshape(-1)
    table[:, 8] = image.channels[3].reshape(-1)
    return classes.reshape(-1), table


def _log_range(metres: Float) -> Float:
    log_range: Float = np.log(np.maximum(metres, NEAREST_M))
    return log_range


def knows_error(network: Network) -> bool:
    """Say whether weights have a model of errors by these features for the classes of results."""
    model = network.card.error
    return model is not None and model.features == FEATURES and network.merging is None


def error_model(network: Network) -> ErrorModel:
    """Return the model of errors of weights."""
    model = network.card.error
    remedy = "`salsanext tune error DATASET WEIGHTS_OUT` fits one to labelled scans"
    if model is None:
        raise WeightsError(
            network.engine.name, "no probability of errors", "weights with one", remedy
        )
    if model.features != FEATURES:
        raise WeightsError(
            network.engine.name, "errors by other features", ", ".join(FEATURES), remedy
        )
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
