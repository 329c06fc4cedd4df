# SPDX-License-Identifier: MIT
"""Network ready to use: range image in, predictions of its pixels out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.engines.backend import Backend, PixelPrediction
from salsanext_cli.core.geometry.network_input import network_input
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.records import Float, RangeImage
from salsanext_cli.core.sensors.sensor import Sensor

if TYPE_CHECKING:
    from salsanext_cli.core.network.segmentation import SegmentationNetwork


@dataclass(frozen=True, eq=False)
class Network:
    """Weights on a device, fitted to the sensor of the scans at hand.

    Attributes
    ----------
    backend : Backend
        Computes with the weights.
    sensor : Sensor
        Geometry and normalisation of the range images: the card's unless another was named.
    merging : ClassMerging, optional
        Merges the classes of the card into the classes of all results but the logits.
    """

    backend: Backend
    sensor: Sensor
    merging: ClassMerging | None = None

    @property
    def card(self) -> WeightsCard:
        """Architecture, label space, sensor and origin of the weights."""
        return self.backend.card

    @property
    def device(self) -> str:
        """Device that computes, such as ``"cpu"`` and ``"cuda:1"``."""
        return self.backend.device

    @property
    def module(self) -> "SegmentationNetwork":
        """Network in torch: (B, 5, H, W) normalised range images to (B, C, H, W) logits."""
        return self.backend.module

    @property
    def space(self) -> LabelSpace:
        """Classes of the results: the classes of the card, merged if requested."""
        return self.card.space if self.merging is None else self.merging.space

    def for_sensor(self, sensor: Sensor) -> "Network":
        """Return the network for another sensor, whose images have the same size."""
        return replace(self, sensor=sensor)

    def at_width(self, width: int) -> "Network":
        """Return the network for images of another width, with which the weights were trained."""
        size = (self.sensor.height, width)
        backend = replace(self.backend, card=self.card.at_width(width), size=size)
        return replace(self, backend=backend, sensor=self.sensor.resized(width=width))

    def input(self, channels: Float) -> Float:
        """Return the input (1, 5, H, W) of the weights from channels (5, H, W) of the sensor."""
        return network_input(channels, self.sensor, self.card.sensor)

    def predict(self, inputs: Sequence[Float], *, softmax: bool = False) -> list[PixelPrediction]:
        """Predict the pixels of inputs, in the classes of `space`.

        The logits are divided by the card's temperature, which preserves their order. The
        probabilities of merged classes are added.

        Parameters
        ----------
        inputs : sequence of (1, 5, H, W) float32
            Inputs, as of `input`.
        softmax : bool
            Whether the predictions have the probabilities of all classes.

        Returns
        -------
        list of PixelPrediction
        """
        temperature = self.card.temperature
        merging = self.merging
        if merging is None:
            return self.backend.predict(inputs, temperature, softmax=softmax)
        predictions = self.backend.predict(inputs, temperature, softmax=True)
        return [
            PixelPrediction.from_softmax(merging.add(cast(Float, pixels.softmax)), keep=softmax)
            for pixels in predictions
        ]

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32, of the classes of the card."""
        (logits,) = self.backend.logits([self.input(image.channels)])
        return logits

    def probabilities(self, image: RangeImage, source: object = "a scan") -> Float:
        """Return the softmax of `predict`.

        Parameters
        ----------
        image : RangeImage
            H × W pixels.
        source : object
            Name of the scan in errors.

        Returns
        -------
        (C, H, W) float32
            Probabilities of the classes of `space`, with sum 1 over C.

        Raises
        ------
        WeightsError
            If they are not finite.
        """
        (prediction,) = self.predict([self.input(image.channels)], softmax=True)
        self.backend.require_finite(prediction.confidence, source)
        return cast(Float, prediction.softmax)
