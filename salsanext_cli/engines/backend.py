# SPDX-License-Identifier: MIT
"""Interface of the libraries that compute a network: images in, predictions and moments out."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.engines.moments import Moments
from salsanext_cli.errors import WeightsError
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.records import Float

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.network.segmentation import SegmentationNetwork


class PixelPrediction(NamedTuple):
    """Prediction for the pixels of a range image."""

    labels: TrainIds  # (H, W) uint8: the likeliest class, the first of equal ones
    confidence: Float  # (H, W) float32: its probability
    softmax: Float | None = None  # (C, H, W) float32, if it was wanted

    @classmethod
    def of(cls, softmax: Float, *, keep: bool = False) -> "PixelPrediction":
        """Reduce a softmax (C, H, W), which may be overwritten later unless it is to `keep`."""
        values = argument(softmax, np.float32).reshape(len(softmax), -1)
        labels = np.zeros(values.shape[1], np.uint8)
        confidence = np.empty(values.shape[1], np.float32)

        def reduce(part: slice) -> None:
            largest(values[:, part], labels[part], confidence[part])

        parallel_for_slices(reduce, len(labels))
        size = softmax.shape[1:]
        kept = softmax.copy() if keep else None
        return cls(labels.reshape(size), confidence.reshape(size), kept)


@compiled
def largest(softmax: Float, labels: TrainIds, confidence: Float) -> None:
    """Write the class of the largest value of each column, which is 0 before, and the value."""
    confidence[:] = softmax[0]
    for k in range(1, len(softmax)):
        values = softmax[k]
        for i in range(len(labels)):
            # What is not finite is to be seen.
            larger = values[i] > confidence[i] or values[i] != values[i]
            confidence[i] = values[i] if larger else confidence[i]
            labels[i] = k if larger else labels[i]


@dataclass(frozen=True, eq=False)
class Backend(ABC):
    """Weights on a device, in evaluation mode, computed by one library; it knows no scans.

    Images are inputs of the network, (1, 5, H, W) float32, normalised.
    """

    library: ClassVar[str]

    # Returns the network in torch, float32, on the device; called when it is first needed
    load_module: "Callable[[], SegmentationNetwork]"
    card: WeightsCard
    size: tuple[int, int]  # Rows and columns of the images
    device: str = "cpu"  # "cpu", "cuda", "cuda:1" …
    precision: str = "float32"  # "float32", "bfloat16" or "float16"
    name: str = "the weights"  # Of the weights file, for errors
    sha256: str | None = None  # Of the weights file; None for weights that no file holds
    code: str = ""  # Digest of the code of a plug-in's network

    @cached_property
    def module(self) -> "SegmentationNetwork":
        """Network in torch: (B, 5, H, W) normalised range images to (B, C, H, W) logits."""
        return self.load_module()

    @abstractmethod
    def predict(
        self, images: Sequence[Float], temperature: float, *, softmax: bool = False
    ) -> list[PixelPrediction]:
        """Predict the pixels of images, their logits divided by a temperature."""

    @abstractmethod
    def logits(self, images: Sequence[Float]) -> list[Float]:
        """Return the logits (C, H, W) float32 of images."""

    @abstractmethod
    def sample(
        self, image: Float, seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> Moments:
        """Return the moments of the softmax over passes of dropout, whose masks have seeds."""

    @abstractmethod
    def spread(self, images: Iterable[Float], merging: ClassMerging | None = None) -> Moments:
        """Return the moments of the softmax over images; the entropies are left out."""

    @abstractmethod
    def run(
        self, name: str, function: Callable[..., Any], *images: Float, exact: bool = False
    ) -> "tuple[Tensor, ...]":
        """Return ``function(module, *images)``, tensors on the device.

        Parameters
        ----------
        name : str
            Identifies the function: what was compiled under this name is used again.
        function : callable
            Takes the network and tensors; returns a tuple of tensors.
        *images : (1, 5, H, W) float32
            Its inputs.
        exact : bool
            Compute in float32, whatever the precision.
        """

    def require_finite(self, values: Float, source: object) -> None:
        """Raise `WeightsError`, naming weights and scan, if a result is not finite."""
        if not np.isfinite(values).all():
            wrong = f"their logits for {source} are not finite"
            raise WeightsError(self.name, wrong, "finite logits", "use other weights")
