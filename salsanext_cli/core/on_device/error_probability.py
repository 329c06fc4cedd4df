# SPDX-License-Identifier: MIT
"""Probability that the labels of a batch are wrong, as `uncertainty.error_features` describes one.

Sums have another order than those of the kernels, so that last bits differ.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device.projection import RangeImages
from salsanext_cli.core.uncertainty.error_features import (
    COLUMNS,
    FEATURES,
    NEAR_M,
    NEAR_SHARE,
    NEAREST_M,
    NEIGHBOURS_OF_REGION,
    ROWS,
    STEP,
    Feature,
)

HEIGHT_CHANNEL = 3  # z
FIXED_POINT = 2.0**40  # Unit of sums of integers, whose order changes no bit
CHUNK_PIXELS = 1 << 24  # Most pixels of windows at once
ROUNDS = 4  # Rounds of joining between checks, for which the host waits; real scans need 9 or 10
MAX_LOGIT = 30.0  # As in `ErrorModel.probability`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledImages:
    """Range images with their softmax, flat: n = B · H · W pixels.

    Attributes
    ----------
    images : RangeImages
        B range images with P points in all.
    ranges : (n,) float32
        Ranges of the pixels in metres, 0 where empty.
    softmax : (n, C) float32
        Probabilities of the classes.
    classes : (n,) int64
        Likeliest class of each pixel.
    """

    images: RangeImages
    ranges: Tensor
    softmax: Tensor
    classes: Tensor

    @classmethod
    def from_softmax(cls, images: RangeImages, softmax: Tensor) -> "LabelledImages":
        """Return images with their softmax (B, C, H, W)."""
        rows = softmax.permute(0, 2, 3, 1).reshape(-1, softmax.shape[1])
        ranges = images.channels[:, 0].reshape(-1)
        return cls(images=images, ranges=ranges, softmax=rows, classes=rows.argmax(dim=1))

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of an image."""
        height, width = self.images.channels.shape[2:]
        return height, width


def error_probability(
    images: RangeImages, softmax: Tensor, labels: Tensor, card: WeightsCard
) -> Tensor:
    """Return the probability that a point's label is wrong.

    Parameters
    ----------
    images : RangeImages
        B range images with P points in all.
    softmax : (B, C, H, W) float32
        Softmax of the pixels at the temperature of the weights.
    labels : (P,) uint8
        Train ids of the points.
    card : WeightsCard
        Card of weights with an error model.

    Returns
    -------
    (P,) float32
        Probabilities, 0…1; NaN without a pixel.
    """
    model = card.error
    if model is None:
        raise ValueError("the weights have no error model")
    if model.temperature is not None and model.temperature != card.temperature:
        exponent = card.temperature / model.temperature
        powers = (softmax / softmax.amax(dim=1, keepdim=True)) ** exponent
        softmax = powers / powers.sum(dim=1, keepdim=True)
    labelled = LabelledImages.from_softmax(images, softmax)
    return _modelled(model, error_features(labelled, labels.long()))


def _modelled(model: ErrorModel, features: Tensor) -> Tensor:
    """Return the probability of an error (P,) of features (P, F)."""
    values = features
    for number, layer in enumerate(model.layers):
        weight, bias = (device_numbers(numbers, values.device) for numbers in layer)
        values = values.relu() if number else values
        values = torch.addmm(bias, values, weight)
    return values[:, 0].clamp(-MAX_LOGIT, MAX_LOGIT).sigmoid()


def error_features(labelled: LabelledImages, labels: Tensor) -> Tensor:
    """Return the features of points.

    Parameters
    ----------
    labelled : LabelledImages
        B range images of P points.
    labels : (P,) int64
        Train ids of the points, after kNN.

    Returns
    -------
    (P, 9) float32
        Columns of `Feature`; NaN for points without a pixel.
    """
    images = labelled.images
    has_pixel = images.pixel_of_point >= 0
    pixel = images.pixel_of_point.clamp(min=0)
    features = _features_of_pixels(labelled)[pixel]
    log_range = _log_range(images.point_range)
    features[:, Feature.LOG_RANGE_BEYOND_PIXEL] = log_range - features[:, Feature.LOG_RANGE]
    features[:, Feature.LOG_RANGE] = log_range
    # Most points have the label of their pixel, and are described by it. The host waits for the
    # number of the others, because windows around all points would take longer.
    other = torch.nonzero(has_pixel & (labels != labelled.classes[pixel]))[:, 0]
    features[other, Feature.LABEL_PROBABILITY] = labelled.softmax[pixel[other], labels[other]]
    features[other, Feature.LABEL_SUPPORT] = label_support(labelled, labels[other], pixel[other])
    return features.where(has_pixel[:, None], torch.nan)


def _features_of_pixels(labelled: LabelledImages) -> Tensor:
    """Return the features (n, 9) of the nearest points of the pixels, with their labels."""
    softmax = labelled.softmax
    largest, second = softmax.topk(2, dim=1).values.unbind(dim=1)
    pixels = torch.arange(len(softmax), device=softmax.device)
    support = label_support(labelled, labelled.classes, pixels)
    table = softmax.new_zeros(len(softmax), len(FEATURES))
    table[:, Feature.LABEL_PROBABILITY] = largest
    table[:, Feature.LARGEST_PROBABILITY] = largest
    table[:, Feature.MARGIN] = largest - second
    table[:, Feature.ENTROPY] = torch.special.entr(softmax).sum(dim=1).clamp(min=0)
    table[:, Feature.LABEL_SUPPORT] = support.where(labelled.ranges > 0, 0)
    table[:, Feature.REGION_PROBABILITY] = region_means(labelled, largest)
    table[:, Feature.LOG_RANGE] = _log_range(labelled.ranges)
    table[:, Feature.HEIGHT] = labelled.images.channels[:, HEIGHT_CHANNEL].reshape(-1)
    return table


def _log_range(metres: Tensor) -> Tensor:
    return metres.clamp(min=NEAREST_M).log()


def label_support(labelled: LabelledImages, labels: Tensor, pixels: Tensor) -> Tensor:
    """Return the mean probability of labels around pixels, at the range of these.

    Parameters
    ----------
    labelled : LabelledImages
        Range images and their softmax.
    labels : (M,) int64
        Train ids.
    pixels : (M,) int64
        Flat index of the pixel of each label.

    Returns
    -------
    (M,) float32
        Probabilities, 0…1; any number or NaN for an empty pixel.
    """
    height, width = labelled.size
    device = pixels.device
    rows = torch.arange(-ROWS, ROWS + 1, STEP, device=device).repeat_interleave(COLUMNS + 1)
    columns = torch.arange(-COLUMNS, COLUMNS + 1, STEP, device=device).repeat(ROWS + 1)
    size = max(1, CHUNK_PIXELS // len(rows))
    supports = [labelled.softmax.new_empty(0)]
    for label, pixel in zip(torch.split(labels, size), torch.split(pixels, size), strict=True):
        row = (pixel // width % height)[:, None] + rows
        column = (pixel[:, None] % width + columns) % width
        first = (pixel - pixel % (height * width))[:, None]
        neighbour = first + row.clamp(0, height - 1) * width + column
        ranges = labelled.ranges[neighbour]
        centre = labelled.ranges[pixel][:, None]
        most = (NEAR_SHARE * centre.double()).clamp(min=NEAR_M)
        is_near = (ranges > 0) & ((ranges - centre).abs() <= most)
        is_near &= (row >= 0) & (row < height)
        probability = labelled.softmax[neighbour, label[:, None]].double()
        total = probability.where(is_near, 0).sum(dim=1)
        supports.append((total / is_near.sum(dim=1)).float())
    return torch.cat(supports)


def region_means(labelled: LabelledImages, values: Tensor) -> Tensor:
    """Return the mean of a value over the region of each pixel, as `mean_of_regions` does.

    Parameters
    ----------
    labelled : LabelledImages
        Range images and the classes of their pixels.
    values : (n,) float32
        Values to average, 0…1.

    Returns
    -------
    (n,) float32
    """
    region = _regions(labelled)
    fixed = (values.double() * FIXED_POINT).round().long()
    totals = torch.zeros_like(fixed).index_add_(0, region, fixed)
    counts = torch.zeros_like(fixed).index_add_(0, region, torch.ones_like(fixed))
    return (totals[region] / (counts[region] * FIXED_POINT)).float()


def _regions(labelled: LabelledImages) -> Tensor:
    """Return the lowest pixel of the region of each pixel, (n,) int64; of an empty one, itself."""
    pairs = torch.cat(list(_neighbours(labelled)), dim=1)
    # A GPU has an instruction for the least of 32 bits in memory, and loops for 64.
    lowest = torch.arange(len(labelled.classes), dtype=torch.int32, device=pairs.device)
    while True:
        for _ in range(ROUNDS):
            before = lowest
            lowest = _joined(before, pairs)
        if torch.equal(before, lowest):
            return lowest.long()


def _joined(lowest: Tensor, pairs: Tensor) -> Tensor:
    """Return the lowest pixels (n,) so far, after regions with neighbours (2, M) are joined.

    Pixels are int32, neighbours int64.
    """
    joined = lowest.clone()
    roots = lowest[pairs]
    least = roots.amin(dim=0)
    for root, pixel in zip(roots, pairs, strict=True):
        # What changes nothing goes to its pixel, because all writes to one root would queue.
        target = root.long().where(root > least, pixel)
        joined.scatter_reduce_(0, target, least, "amin")
    return joined[joined.long()]


def _neighbours(labelled: LabelledImages) -> Iterator[Tensor]:
    """Yield pairs (2, M) of flat indices of neighbours of one class; others pair with themselves.

    So their number is known without their values.
    """
    height, width = labelled.size
    occupied = (labelled.ranges > 0).view(-1, height, width)
    classes = labelled.classes.view(-1, height, width).where(occupied, -1)
    index = torch.arange(classes.numel(), device=classes.device).view(classes.shape)
    for rows, columns in NEIGHBOURS_OF_REGION:
        inside = slice(-rows, None)
        other_classes = classes[:, : height + rows].roll(-columns, dims=2)
        other_index = index[:, : height + rows].roll(-columns, dims=2)
        is_same = (classes[:, inside] == other_classes) & occupied[:, inside]
        first = index[:, inside]
        yield torch.stack([first.flatten(), other_index.where(is_same, first).flatten()])
