# SPDX-License-Identifier: MIT
"""Probability that the labels of a batch are wrong, as `uncertainty.error_features` describes one.

Sums have another order than those of the kernels, so that last bits differ.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.on_device.projection import RangeImages
from salsanext_cli.core.on_device.regions import EMPTY, ROUNDS, Regions
from salsanext_cli.core.uncertainty.error_features import (
    COLUMNS,
    FEATURES,
    NEAR_M,
    NEAR_SHARE,
    NEAREST_M,
    ROWS,
    STEP,
    Feature,
)

HEIGHT_CHANNEL = 3  # z
CHUNK_PIXELS = 1 << 24  # Most pixels of windows at once
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
    """

    images: RangeImages
    ranges: Tensor
    softmax: Tensor

    @classmethod
    def from_softmax(cls, images: RangeImages, softmax: Tensor) -> "LabelledImages":
        """Return images with their softmax (B, C, H, W)."""
        rows = softmax.permute(0, 2, 3, 1).reshape(-1, softmax.shape[1])
        return cls(images=images, ranges=images.channels[:, 0].reshape(-1), softmax=rows)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of an image."""
        height, width = self.images.channels.shape[2:]
        return height, width

    @property
    def classes(self) -> Tensor:
        """Likeliest class of each pixel, (B, H, W) int64; `EMPTY` where there is no point."""
        occupied = self.images.occupied
        return self.softmax.argmax(dim=1).view(occupied.shape).where(occupied, EMPTY)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointErrors:
    """Probabilities that the labels of P points of B scans are wrong.

    Attributes
    ----------
    probability : (P,) float32
        Probabilities, 0…1; NaN without a pixel.
    is_final : (B,) bool
        Whether the regions of a scan were whole; else more rounds change its probabilities.
    """

    probability: Tensor
    is_final: Tensor


def error_probability(
    images: RangeImages, softmax: Tensor, labels: Tensor, card: WeightsCard, rounds: int = ROUNDS
) -> PointErrors:
    """Return the probability that a point's label is wrong, without waiting for the device.

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
    rounds : int
        Number of rounds in which regions are joined.

    Returns
    -------
    PointErrors
    """
    model = card.error
    if model is None:
        raise ValueError("the weights have no error model")
    if model.temperature is not None and model.temperature != card.temperature:
        exponent = card.temperature / model.temperature
        powers = (softmax / softmax.amax(dim=1, keepdim=True)) ** exponent
        softmax = powers / powers.sum(dim=1, keepdim=True)
    labelled = LabelledImages.from_softmax(images, softmax)
    regions = Regions.from_classes(labelled.classes, rounds)
    features = error_features(labelled, labels.long(), regions)
    return PointErrors(probability=_modelled(model, features), is_final=regions.is_whole)


def _modelled(model: ErrorModel, features: Tensor) -> Tensor:
    """Return the probability of an error (P,) of features (P, F)."""
    values = features
    for number, layer in enumerate(model.layers):
        weight, bias = (device_numbers(numbers, values.device) for numbers in layer)
        values = values.relu() if number else values
        values = torch.addmm(bias, values, weight)
    return values[:, 0].clamp(-MAX_LOGIT, MAX_LOGIT).sigmoid()


def error_features(labelled: LabelledImages, labels: Tensor, regions: Regions) -> Tensor:
    """Return the features of points.

    Parameters
    ----------
    labelled : LabelledImages
        B range images of P points.
    labels : (P,) int64
        Train ids of the points, after kNN.
    regions : Regions
        Regions of the classes of the pixels.

    Returns
    -------
    (P, 9) float32
        Columns of `Feature`; NaN for points without a pixel.
    """
    images = labelled.images
    has_pixel = images.pixel_of_point >= 0
    pixel = images.pixel_of_point.clamp(min=0)
    features = _features_of_pixels(labelled, regions)[pixel]
    log_range = _log_range(images.point_range)
    features[:, Feature.LOG_RANGE_BEYOND_PIXEL] = log_range - features[:, Feature.LOG_RANGE]
    features[:, Feature.LOG_RANGE] = log_range
    # Most points have the label of their pixel, but the host does not wait to learn which.
    features[:, Feature.LABEL_PROBABILITY] = labelled.softmax[pixel, labels]
    features[:, Feature.LABEL_SUPPORT] = label_support(labelled, labels, pixel)
    return features.where(has_pixel[:, None], torch.nan)


def _features_of_pixels(labelled: LabelledImages, regions: Regions) -> Tensor:
    """Return the features (n, 9) of the nearest points of the pixels, but those of a label."""
    softmax = labelled.softmax
    largest, second = softmax.topk(2, dim=1).values.unbind(dim=1)
    table = softmax.new_zeros(len(softmax), len(FEATURES))
    table[:, Feature.LARGEST_PROBABILITY] = largest
    table[:, Feature.MARGIN] = largest - second
    table[:, Feature.ENTROPY] = torch.special.entr(softmax).sum(dim=1).clamp(min=0)
    table[:, Feature.REGION_PROBABILITY] = regions.means(largest)
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
