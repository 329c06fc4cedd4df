# SPDX-License-Identifier: MIT
"""Features of a point that predict the error of its label, from a single pass of the network.

They are independent of the classes, and all but the height of the sensor.
"""

import numpy as np

from salsanext_cli.core import wording
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.engines.moments import entropy
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.geometry.objects import root
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.records import Float, Int, Mask, RangeImage

ROWS, COLUMNS, STEP = 4, 8, 2
"""Rows and columns of the window on each side, and the step between them."""
NEAR_M, NEAR_SHARE = 1.0, 0.05  # Ranges of one surface differ by less, in metres or relatively
COST = 8  # Time of a window relative to the projection of a point


def label_support(image: RangeImage, probabilities: Float, labels: TrainIds, pixels: Int) -> Float:
    """Return the mean probability (M,) of labels (M,) around pixels (M,) at their range.

    The window has every second row and column of 9 × 17 pixels; narrow images repeat columns.
    """
    ranges, softmax = argument(image.channels[0], np.float32), argument(probabilities, np.float32)
    labels, pixels = argument(labels, np.uint8), argument(pixels, np.int32)
    support = np.empty(len(labels), np.float32)

    def describe(part: slice) -> None:
        mean_in_windows(ranges, softmax, labels[part], pixels[part], support[part])

    parallel_for_slices(describe, len(labels), COST)
    return support


@compiled
def mean_in_windows(
    ranges: Float, probabilities: Float, labels: TrainIds, pixels: Int, support: Float
) -> None:
    """Write the result of `label_support`."""
    height, width = ranges.shape
    # A table: a division for each pixel of a window would take longer than the rest.
    columns = np.arange(-COLUMNS, width + COLUMNS) % width
    for i in range(len(labels)):
        v, u = pixels[i] // width, pixels[i] % width
        centre, of_label = ranges[v, u], probabilities[labels[i]]
        most = max(NEAR_M, NEAR_SHARE * centre)
        count, total = 0, 0.0
        for row in range(v - ROWS, v + ROWS + 1, STEP):
            if 0 <= row < height:
                for column in columns[u : u + 2 * COLUMNS + 1 : STEP]:
                    if ranges[row, column] > 0 and abs(ranges[row, column] - centre) <= most:
                        count += 1
                        total += of_label[row, column]
        support[i] = total / count


@compiled
def mean_of_regions(occupied: Mask, classes: TrainIds, values: Float, means: Float) -> None:
    """Write the mean (H, W) of a value over the region of each pixel; empty pixels are unchanged.

    A region consists of occupied pixels of one class. Neighbours are adjacent, also diagonally and
    around the image, or have one pixel of their row or column in between. This is union-find with
    the lowest pixel as the root.
    """
    height, width = occupied.shape
    parent = np.arange(height * width)
    for v in range(height):
        for u in range(width):
            if not occupied[v, u]:
                continue
            for dv, du in ((0, -1), (0, -2), (-1, -1), (-1, 0), (-1, 1), (-2, 0)):
                row, column = v + dv, (u + du) % width
                if row < 0 or not occupied[row, column] or classes[row, column] != classes[v, u]:
                    continue
                one, other = root(parent, v * width + u), root(parent, row * width + column)
                parent[max(one, other)] = min(one, other)
    count, total = np.zeros(parent.size), np.zeros(parent.size)
    for i in range(parent.size):
        # A parent is lower than its child, so it has its root already.
        parent[i] = parent[parent[i]]
        count[parent[i]] += 1
        total[parent[i]] += values[i // width, i % width]
    for i in range(parent.size):
        means[i // width, i % width] = total[parent[i]] / count[parent[i]]


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
NEAREST_M = 0.5  # Lower bound of ranges in logarithms


def error_features(image: RangeImage, probabilities: Float, labels: TrainIds) -> Float:
    """Return the features of points, (N, 9) float32, NaN without a pixel; labels after kNN."""
    # Most points have the label of their pixel and are described once per pixel, others alone.
    classes, table = _of_pixels(image, probabilities)
    features = np.empty((len(labels), len(FEATURES)), np.float32)
    differs = np.empty(len(labels), bool)

    def gather(part: slice) -> None:
        pixels, log_range = image.pixel_of_point[part], _log_range(image.point_range[part])
        table.take(pixels, 0, features[part], "clip")
        features[part, 6] = log_range - features[part, 7]
        features[part, 7] = log_range
        differs[part] = labels[part] != classes.take(pixels, mode="clip")

    parallel_for_slices(gather, len(labels))
    other = np.flatnonzero(differs & (image.pixel_of_point >= 0))
    other_labels, pixels = labels[other], image.pixel_of_point[other]
    features[other, 0] = probabilities.reshape(len(probabilities), -1)[other_labels, pixels]
    features[other, 4] = label_support(image, probabilities, other_labels, pixels)
    features[image.pixel_of_point < 0] = np.nan
    return features


def _of_pixels(image: RangeImage, probabilities: Float) -> tuple[TrainIds, Float]:
    """Return the class of each pixel, (H · W,), and features of its nearest point, (H · W, 9)."""
    largest, second, means = np.zeros((3, *probabilities.shape[1:]), np.float32)
    classes = np.zeros(largest.shape, np.uint8)
    for train_id, of_class in enumerate(probabilities):
        np.copyto(classes, train_id, where=of_class > largest)
        np.maximum(second, np.minimum(largest, of_class), out=second)
        np.maximum(largest, of_class, out=largest)
    table = np.zeros((classes.size, len(FEATURES)), np.float32)
    table[:, 0] = table[:, 1] = largest.reshape(-1)
    table[:, 2] = (largest - second).reshape(-1)
    table[:, 3] = entropy(probabilities).reshape(-1)
    occupied = np.flatnonzero(image.channels[0] > 0).astype(np.int32)
    of_pixel = classes.reshape(-1)[occupied]
    table[occupied, 4] = label_support(image, probabilities, of_pixel, occupied)
    mean_of_regions(image.channels[0] > 0, classes, largest, means)
    table[:, 5] = means.reshape(-1)
    table[:, 7] = _log_range(image.channels[0]).reshape(-1)
    table[:, 8] = image.channels[3].reshape(-1)
    return classes.reshape(-1), table


def _log_range(metres: Float) -> Float:
    return np.log(np.maximum(metres, NEAREST_M))


def knows_error(network: Network) -> bool:
    """Return whether weights have an error model of these features and of the result's classes."""
    model = network.card.error
    return model is not None and model.features == FEATURES and network.merging is None


def error_model(network: Network) -> ErrorModel:
    """Return the error model of weights."""
    model, weights = network.card.error, network.backend.name
    hint = "fit one to labelled scans with `salsanext tune error DATASET WEIGHTS_OUT`"
    if model is None:
        raise WeightsError(weights, "has no error model", hint=hint)
    if model.features != FEATURES:
        raise WeightsError(weights, "has an error model of other features", hint=hint)
    if network.merging is not None:
        problem = "the error model does not cover merged classes"
        raise UsageError(wording.argument("classes"), problem, "the classes of the weights")
    return model


def error_probability(
    network: Network, image: RangeImage, probabilities: Float, labels: TrainIds
) -> Float:
    """Return the probability that a point's label is wrong, (N,) float32, NaN without a pixel."""
    return error_model(network).probability(features_of(network, image, probabilities, labels))


def features_of(
    network: Network, image: RangeImage, probabilities: Float, labels: TrainIds
) -> Float:
    """Return `error_features` of the softmax at the temperature of the network's error model."""
    card = network.card
    if card.error and card.error.temperature not in (None, card.temperature):
        exponent = np.float32(card.temperature / card.error.temperature)
        powers = (probabilities / probabilities.max(axis=0)) ** exponent
        probabilities = powers / powers.sum(axis=0)
    return error_features(image, probabilities, labels)
