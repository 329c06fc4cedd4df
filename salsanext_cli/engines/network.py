# SPDX-License-Identifier: MIT
"""A network ready to use: range image in, probabilities out, point labels of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.engines.engine import Engine
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.network_input import ScanFit
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.options import KnnParameters
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.sensors.sensor import Sensor

if TYPE_CHECKING:
    from salsanext_cli.network.segmentation import SegmentationNetwork


@dataclass(frozen=True, eq=False)
class Network:
    """Weights on a device, fitted to the sensor of the scans at hand.

    Attributes
    ----------
    engine : Engine
        Computes with the weights.
    fit : ScanFit
        Makes the input of the weights of range images of the sensor.
    merging : ClassMerging, optional
        Merges the classes of the card into those of all results but the logits.
    """

    engine: Engine
    fit: ScanFit
    merging: ClassMerging | None = None

    @property
    def card(self) -> WeightsCard:
        """Architecture, label space, sensor and origin of the weights."""
        return self.engine.card

    @property
    def device(self) -> str:
        """Device that computes, such as ``"cpu"``, ``"cuda"`` and ``"cuda:1"``."""
        return self.engine.device

    @property
    def module(self) -> "SegmentationNetwork":
        """Network in torch: (B, 5, H, W) normalised range images to (B, C, H, W) logits."""
        return self.engine.module

    @property
    def sensor(self) -> Sensor:
        """Geometry and normalisation of the range images: the card's unless another was named."""
        return self.fit.sensor

    @property
    def space(self) -> LabelSpace:
        """Classes of the results: those of the card, merged if that was asked for."""
        return self.card.space if self.merging is None else self.merging.space

    @property
    def groups(self) -> tuple[tuple[int, ...], ...] | None:
        """Train ids of the card that are merged into each class, None if none are."""
        return None if self.merging is None else self.merging.groups

    def for_sensor(self, sensor: Sensor) -> "Network":
        """Return the network for another sensor, whose images have the same size."""
        return replace(self, fit=replace(self.fit, sensor=sensor))

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32, of the classes of the card."""
        return self.engine.logits(self.fit.input(image.channels))

    def probabilities(self, image: RangeImage, source: object = "a scan") -> Float:
        """Return the softmax of every pixel, (C, H, W) float32, sum over C = 1.

        The logits are divided by the card's temperature, which leaves their order as it is; the
        probabilities of merged classes are added.

        Parameters
        ----------
        image : RangeImage
            One scan.
        source : object
            What to call it in an error.

        Raises
        ------
        WeightsError
            If the softmax is not finite.
        """
        (probabilities,) = self.pixel_probabilities([image.channels])
        self.engine.require_finite(probabilities, source)
        return probabilities

    def pixel_probabilities(
        self, channels: Sequence[Float], temperature: float | None = None
    ) -> list[Float]:
        """Return the softmax (C, H, W) of some range images, (5, H, W) float32 each.

        As `Engine.softmax`, in the classes of the results; it may not be finite.
        """
        softmax = self.engine.softmax([self.fit.input(each) for each in channels], temperature)
        return [self.merged(each) for each in softmax]

    def merged(self, probabilities: Float) -> Float:
        """Add the probabilities of classes that are merged, if any are: (C, …) to (K, …)."""
        return probabilities if self.merging is None else self.merging.add(probabilities)

    def labels(
        self, image: RangeImage, scores: Float, knn: KnnParameters = KnnParameters()
    ) -> TrainIds:
        """Return labels of the points, (N,) uint8: the largest score (C, H, W), refined by kNN."""
        return knn_refine(image, scores.argmax(axis=0), len(scores), knn, self.device)
