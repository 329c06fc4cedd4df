# SPDX-License-Identifier: MIT
"""Interface of the libraries that compute a network."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.engines.moments import SoftmaxSpread
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.records import Float

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.core.network.segmentation import SegmentationNetwork


LOGITS = "logits"  # Name of the last convolution, in every architecture


class PixelPrediction(NamedTuple):
    """Prediction for the pixels of a range image.

    Attributes
    ----------
    labels : (H, W) uint8
        The likeliest class, the first of equal ones.
    confidence : (H, W) float32
        Its probability.
    softmax : (C, H, W) float32, optional
        Probabilities of all classes, if requested.
    """

    labels: TrainIds
    confidence: Float
    softmax: Float | None = None

    @classmethod
    def from_softmax(cls, softmax: Float, *, keep: bool = False) -> "PixelPrediction":
        """Reduce a softmax to a prediction.

        Parameters
        ----------
        softmax : (C, H, W) float32
            Probabilities of all classes.
        keep : bool
            Whether the prediction has a copy of them.

        Returns
        -------
        PixelPrediction
        """
        values = argument(softmax, np.float32).reshape(len(softmax), -1)
        labels = np.zeros(values.shape[1], np.uint8)
        confidence = np.empty(values.shape[1], np.float32)

        def reduce(pixels: slice) -> None:
            largest(values[:, pixels], labels[pixels], confidence[pixels])

        parallel_for_slices(reduce, len(labels))
        size = softmax.shape[1:]
        copy = softmax.copy() if keep else None
        return cls(labels.reshape(size), confidence.reshape(size), copy)


@compiled
def largest(softmax: Float, labels: TrainIds, confidence: Float) -> None:
    """Write class and value of the largest value of each column.

    Parameters
    ----------
    softmax : (C, P) float32
        Probabilities of the classes of P pixels.
    labels : (P,) uint8
        Result; 0 before.
    confidence : (P,) float32
        Result: the largest probability.
    """
    # A loop compiles in a tenth of the time of the assignment of a slice.
    for i in range(len(labels)):
        confidence[i] = softmax[0, i]
    for k in range(1, len(softmax)):
        values = softmax[k]
        for i in range(len(labels)):
            # NaN wins, so that it can be detected.
            larger = values[i] > confidence[i] or values[i] != values[i]
            confidence[i] = values[i] if larger else confidence[i]
            labels[i] = k if larger else labels[i]


@dataclass(frozen=True, eq=False)
class Backend(ABC):
    """Weights on a device, in evaluation mode, computed by one library.

    Images are inputs of the network, (1, 5, H, W) float32, normalised.

    Attributes
    ----------
    load_module : callable
        Returns the network in torch, float32, on the device; called when it is first needed.
    card : WeightsCard
        Metadata of the weights.
    size : tuple of int
        Height and width of the images.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` …
    precision : {"float32", "bfloat16", "float16", "int8"}
        Number type of most layers.
    name, sha256 : str
        Name of the weights file, for errors, and its digest; None for weights without a file.
    code : str
        Digest of the source of a plug-in's network.
    """

    library: ClassVar[str]
    needs_module: ClassVar[bool] = True
    """Whether it computes with the torch module itself, so that the module is loaded at once."""

    load_module: "Callable[[], SegmentationNetwork]"
    card: WeightsCard
    size: tuple[int, int]
    device: str = "cpu"
    precision: str = "float32"
    name: str = "the weights"
    sha256: str | None = None
    code: str = ""

    @cached_property
    def module(self) -> "SegmentationNetwork":
        """Network in torch: (B, 5, H, W) normalised range images to (B, C, H, W) logits."""
        return self.load_module()

    @abstractmethod
    def predict(
        self, images: Sequence[Float], temperature: float, *, softmax: bool = False
    ) -> list[PixelPrediction]:
        """Predict the pixels of images.

        Parameters
        ----------
        images : sequence of (1, 5, H, W) float32
            Inputs of the network.
        temperature : float
            Divisor of the logits.
        softmax : bool
            Whether the predictions have the probabilities of all classes.

        Returns
        -------
        list of PixelPrediction
        """

    @abstractmethod
    def logits(self, images: Sequence[Float]) -> list[Float]:
        """Return the logits (C, H, W) float32 of images."""

    @abstractmethod
    def sample(
        self, image: Float, seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> SoftmaxSpread:
        """Return the spread of the softmax over dropout passes.

        Parameters
        ----------
        image : (1, 5, H, W) float32
            Input of the network.
        seeds : sequence of int
            Seed of the masks of each pass.
        merging : ClassMerging, optional
            Merging of the classes, whose probabilities are added in each pass.

        Returns
        -------
        SoftmaxSpread
        """

    @abstractmethod
    def spread(self, images: Iterable[Float], merging: ClassMerging | None = None) -> Float:
        """Return the unbiased variance of the softmax over images.

        Parameters
        ----------
        images : iterable of (1, 5, H, W) float32
            Inputs of the network.
        merging : ClassMerging, optional
            Merging of the classes.

        Returns
        -------
        (C, H, W) float32
        """

    @abstractmethod
    def run(
        self, name: str, function: Callable[..., Any], *images: Float, exact: bool = False
    ) -> "tuple[Tensor, ...]":
        """Return ``function(module, *images)``.

        Parameters
        ----------
        name : str
            Identifies the function in the cache of graphs.
        function : callable
            Function of the network in torch and of tensors (1, …) to a tuple of tensors.
        *images : (1, …) float32
            Arguments.
        exact : bool
            Whether to compute in float32.

        Returns
        -------
        tuple of Tensor
            Results on the device.
        """

    def require_finite(self, values: Float, source: object) -> None:
        """Raise `WeightsError` with weights and scan if a result is not finite."""
        if not np.isfinite(values).all():
            raise self.not_finite(source)

    def not_finite(self, source: object) -> WeightsError:
        """Return the error about weights whose results of a scan are not finite."""
        problem = f"the logits of {source} are not finite"
        return WeightsError(self.name, problem, hint="use other weights")


@dataclass(frozen=True, eq=False)
class DeviceBackend(Backend):
    """Backend whose device has the inputs and the results of the network, as tensors of torch.

    Where it computes on a GPU, `core.on_device` labels the points and estimates there too.
    """

    @abstractmethod
    def softmax(self, images: "Tensor", temperature: float) -> "Tensor":
        """Return probabilities on the device, without waiting for them.

        Parameters
        ----------
        images : (B, 5, H, W) float32
            Inputs of the network on the device.
        temperature : float
            Divisor of the logits.

        Returns
        -------
        (B, C, H, W) float32
        """

    @abstractmethod
    def device_logits(self, images: "Tensor") -> "Tensor":
        """Return the logits (B, C, H, W) float32 of inputs (B, 5, H, W) on the device."""

    @abstractmethod
    def device_sample(
        self, image: "Tensor", seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> "dict[str, Tensor]":
        """Return the attributes of `SoftmaxSpread` on the device, without waiting for it.

        Parameters
        ----------
        image : (1, 5, H, W) float32
            Input of the network on the device.
        seeds, merging
            As for `sample`.

        Returns
        -------
        dict of Tensor
            float32, by name.
        """

    @abstractmethod
    def device_spread(self, images: "Tensor", merging: ClassMerging | None = None) -> "Tensor":
        """Return the result of `spread` on the device, of inputs (B, 5, H, W) there."""

    @abstractmethod
    def device_run(
        self, name: str, function: Callable[..., Any], *images: "Tensor", exact: bool = False
    ) -> "tuple[Tensor, ...]":
        """Return the result of `run` of tensors (1, …) on the device."""


def device_backend(backend: Backend) -> DeviceBackend:
    """Return a backend as one that computes from tensors.

    Parameters
    ----------
    backend : Backend
        Backend of a network.

    Returns
    -------
    DeviceBackend

    Raises
    ------
    TypeError
        If it computes from arrays only.
    """
    if not isinstance(backend, DeviceBackend):
        raise TypeError(f"{backend.library} computes from no tensors on a device")
    return backend
