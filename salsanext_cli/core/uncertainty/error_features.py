# SPDX-License-Identifier: MIT
"""Features of a point that predict the error of its label, from a single pass of the network.

They are independent of the classes, and all but the height of the sensor.
"""

from dataclasses import dataclass
from enum import IntEnum

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

ROWS = 4  # Rows of the window above the pixel, and as many below
COLUMNS = 8  # Columns of the window on each side
STEP = 2  # Step between rows and between columns of the window
NEAR_M = 1.0  # Ranges of one surface differ by less, in metres, or by less than
NEAR_SHARE = 0.05  # this share of the range
NEIGHBOURS_OF_REGION = ((0, -1), (0, -2), (-1, -1), (-1, 0), (-1, 1), (-2, 0))
"""Steps in rows and columns to the neighbours of a pixel before it that may be of its region."""
COST = 8  # Time of a window relative to the projection of a point


def label_support(image: RangeImage, probabilities: Float, labels: TrainIds, pixels: Int) -> Float:
    """Return the mean probability of labels around pixels, at the range of these.

    The window has every second row and column of 9 × 17 pixels; narrow images repeat columns.

    Parameters
    ----------
    image : RangeImage
        H × W pixels.
    probabilities : (C, H, W) float32
        Softmax of the pixels.
    labels : (M,) uint8
        Train ids.
    pixels : (M,) int32
        Flat index of the occupied pixel of each label.

    Returns
    -------
    (M,) float32
        Probabilities, 0…1.
    """
    ranges = argument(image.channels[0], np.float32)
    softmax = argument(probabilities, np.float32)
    labels = argument(labels, np.uint8)
    pixels = argument(pixels, np.int32)
    support = np.empty(len(labels), np.float32)

    def describe(places: slice) -> None:
        mean_in_windows(ranges, softmax, labels[places], pixels[places], support[places])

    parallel_for_slices(describe, len(labels), COST)
    return support


@compiled
def mean_in_windows(
    ranges: Float, probabilities: Float, labels: TrainIds, pixels: Int, support: Float
) -> None:
    """Write the result of `label_support`.

    Parameters
    ----------
    ranges : (H, W) float32
        Ranges of the pixels in metres, 0 where empty.
    probabilities : (C, H, W) float32
        Softmax of the pixels.
    labels : (M,) uint8
        Train ids of M points.
    pixels : (M,) int32
        Flat pixel index of each point.
    support : (M,) float32
        Result.
    """
    height, width = ranges.shape
    # A table: a division for each pixel of a window would take longer than the rest.
    columns = np.arange(-COLUMNS, width + COLUMNS) % width
    for i in range(len(labels)):
        v = pixels[i] // width
        u = pixels[i] % width
        centre = ranges[v, u]
        label_probability = probabilities[labels[i]]
        most = max(NEAR_M, NEAR_SHARE * centre)
        count = 0
        total = 0.0
        for row in range(v - ROWS, v + ROWS + 1, STEP):
            if 0 <= row < height:
                for column in columns[u : u + 2 * COLUMNS + 1 : STEP]:
                    if ranges[row, column] > 0 and abs(ranges[row, column] - centre) <= most:
                        count += 1
                        total += label_probability[row, column]
        support[i] = total / count


@compiled
def mean_of_regions(occupied: Mask, classes: TrainIds, values: Float, means: Float) -> None:
    """Write the mean of a value over the region of each pixel.

    A region consists of occupied pixels of one class. Neighbours are adjacent, also diagonally and
    around the image, or have one pixel of their row or column in between. This is union-find with
    the lowest pixel as the root.

    Parameters
    ----------
    occupied : (H, W) bool
        Whether a pixel has a point.
    classes : (H, W) uint8
        Train ids.
    values : (H, W) float32
        Values to average.
    means : (H, W) float32
        Result; an empty pixel has its own value.
    """
    height, width = occupied.shape
    parent = np.arange(height * width)
    for v in range(height):
        for u in range(width):
            if not occupied[v, u]:
                continue
            for dv, du in NEIGHBOURS_OF_REGION:
                row = v + dv
                column = (u + du) % width
                if row < 0 or not occupied[row, column] or classes[row, column] != classes[v, u]:
                    continue
                first = root(parent, v * width + u)
                second = root(parent, row * width + column)
                parent[max(first, second)] = min(first, second)
    count = np.zeros(parent.size)
    total = np.zeros(parent.size)
    for i in range(parent.size):
        # A parent is lower than its child, so it has its root already.
        parent[i] = parent[parent[i]]
        count[parent[i]] += 1
        total[parent[i]] += values[i // width, i % width]
    for i in range(parent.size):
        means[i // width, i % width] = total[parent[i]] / count[parent[i]]


class Feature(IntEnum):
    """Columns of the features, in the order of `FEATURES`."""

    LABEL_PROBABILITY = 0
    LARGEST_PROBABILITY = 1
    MARGIN = 2
    ENTROPY = 3
    LABEL_SUPPORT = 4
    REGION_PROBABILITY = 5
    LOG_RANGE_BEYOND_PIXEL = 6
    LOG_RANGE = 7
    HEIGHT = 8


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
"""Names in weights files."""
NEAREST_M = 0.5  # Lower bound of ranges in logarithms


def error_features(image: RangeImage, probabilities: Float, labels: TrainIds) -> Float:
    """Return the features of points.

    Parameters
    ----------
    image : RangeImage
        H × W pixels of N points.
    probabilities : (C, H, W) float32
        Softmax of the pixels.
    labels : (N,) uint8
        Train ids of the points, after kNN.

    Returns
    -------
    (N, 9) float32
        Columns of `Feature`; NaN for points without a pixel.
    """
    # Most points have the label of their pixel and are described once per pixel, others alone.
    pixel_features = _features_of_pixels(image, probabilities)
    features = np.empty((len(labels), len(FEATURES)), np.float32)
    differs = np.empty(len(labels), bool)

    def gather(points: slice) -> None:
        pixels = image.pixel_of_point[points]
        log_range = _log_range(image.point_range[points])
        rows = features[points]
        pixel_features.table.take(pixels, 0, rows, "clip")
        rows[:, Feature.LOG_RANGE_BEYOND_PIXEL] = log_range - rows[:, Feature.LOG_RANGE]
        rows[:, Feature.LOG_RANGE] = log_range
        differs[points] = labels[points] != pixel_features.classes.take(pixels, mode="clip")

    parallel_for_slices(gather, len(labels))
    other = np.flatnonzero(differs & (image.pixel_of_point >= 0))
    other_labels = labels[other]
    pixels = image.pixel_of_point[other]
    flat = probabilities.reshape(len(probabilities), -1)
    features[other, Feature.LABEL_PROBABILITY] = flat[other_labels, pixels]
    support = label_support(image, probabilities, other_labels, pixels)
    features[other, Feature.LABEL_SUPPORT] = support
    features[image.pixel_of_point < 0] = np.nan
    return features


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _PixelFeatures:
    """Features of the nearest point of each of P = H · W pixels, with the label of its pixel."""

    classes: TrainIds  # (P,)
    table: Float  # (P, 9): columns of `Feature`


def _features_of_pixels(image: RangeImage, probabilities: Float) -> _PixelFeatures:
    """Return the features of the pixels by their softmax (C, H, W)."""
    size = probabilities.shape[1:]
    largest = np.zeros(size, np.float32)
    second = np.zeros(size, np.float32)
    classes = np.zeros(size, np.uint8)
    for train_id, probability in enumerate(probabilities):
        np.copyto(classes, train_id, where=probability > largest)
        np.maximum(second, np.minimum(largest, probability), out=second)
        np.maximum(largest, probability, out=largest)
    has_point = image.channels[0] > 0
    occupied = np.flatnonzero(has_point).astype(np.int32)
    labels = classes.reshape(-1)[occupied]
    region_means = np.zeros(size, np.float32)
    mean_of_regions(has_point, classes, largest, region_means)
    table = np.zeros((classes.size, len(FEATURES)), np.float32)
    table[:, Feature.LABEL_PROBABILITY] = largest.reshape(-1)
    table[:, Feature.LARGEST_PROBABILITY] = largest.reshape(-1)
    table[:, Feature.MARGIN] = (largest - second).reshape(-1)
    table[:, Feature.ENTROPY] = entropy(probabilities).reshape(-1)
    support = label_support(image, probabilities, labels, occupied)
    table[occupied, Feature.LABEL_SUPPORT] = support
    table[:, Feature.REGION_PROBABILITY] = region_means.reshape(-1)
    table[:, Feature.LOG_RANGE] = _log_range(image.channels[0]).reshape(-1)
    table[:, Feature.HEIGHT] = image.channels[3].reshape(-1)
    return _PixelFeatures(classes=classes.reshape(-1), table=table)


def _log_range(metres: Float) -> Float:
    return np.log(np.maximum(metres, NEAREST_M))


def knows_error(network: Network) -> bool:
    """Return whether weights have an error model of these features and of the result's classes."""
    model = network.card.error
    return model is not None and model.features == FEATURES and network.merging is None


def error_model(network: Network) -> ErrorModel:
    """Return the error model of weights; raise the errors of `error_probability`."""
    model = network.card.error
    weights = network.backend.name
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
    """Return the probability that a point's label is wrong.

    Parameters
    ----------
    network : Network
        Network with an error model.
    image : RangeImage
        H × W pixels of N points.
    probabilities : (C, H, W) float32
        Softmax of the pixels at the temperature of the weights.
    labels : (N,) uint8
        Train ids of the points.

    Returns
    -------
    (N,) float32
        Probabilities, 0…1; NaN without a pixel.

    Raises
    ------
    WeightsError
        If the weights have no error model of these features.
    UsageError
        If classes are merged.
    """
    return error_model(network).probability(features_of(network, image, probabilities, labels))


def features_of(
    network: Network, image: RangeImage, probabilities: Float, labels: TrainIds
) -> Float:
    """Return `error_features` of the softmax at the temperature of the network's error model.

    Parameters
    ----------
    network : Network
        Network, perhaps with an error model.
    image : RangeImage
        H × W pixels of N points.
    probabilities : (C, H, W) float32
        Softmax of the pixels at the temperature of the weights.
    labels : (N,) uint8
        Train ids of the points.

    Returns
    -------
    (N, 9) float32
    """
    card = network.card
    if card.error and card.error.temperature not in (None, card.temperature):
        exponent = np.float32(card.temperature / card.error.temperature)
        powers = (probabilities / probabilities.max(axis=0)) ** exponent
        probabilities = powers / powers.sum(axis=0)
    return error_features(image, probabilities, labels)
