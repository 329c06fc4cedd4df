# SPDX-License-Identifier: MIT
"""A network ready to use: range image in, probabilities out."""

import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.compiled.kernels import thread_count
from salsanext_cli.engines.graphs import Graph, compiled_graph, converted
from salsanext_cli.errors import WeightsError
from salsanext_cli.geometry.intensity import match_intensity
from salsanext_cli.geometry.normalise import normalise
from salsanext_cli.geometry.row_gaps import with_filled_gaps
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.sensors.sensor import Sensor

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.network.segmentation import SegmentationNetwork
import logging
from typing import TypeVar

from salsanext_cli.errors import out_of_memory

log = logging.getLogger(__name__)
Item = TypeVar("Item")
Result = TypeVar("Result")


def halved_batches(
    function: Callable[[Sequence[Item]], Iterable[Result]],
    items: Sequence[Item],
    most: int,
    name: str,
    sizes: dict[str, int],
) -> list[Result]:
    """Return the results of a function of batches, halved where memory runs out.

    `function`: takes some of the items, yields a result of each; `most`: items at once, as long as
    there is room; `name`: of the items, in the plural; `sizes`: number of items by name that there
    was room for at once; is filled.
    """
    found: list[Result] = []
    while len(found) < len(items):
        size = min(most, sizes.get(name, most))
        batch = items[len(found) : len(found) + size]
        try:
            found.extend(function(batch))
        except (MemoryError, RuntimeError) as error:
            if not out_of_memory(error):
                raise
            if len(batch) == 1:
                raise MemoryError(f"no room for one of the {name}") from error
            size = sizes[name] = len(batch) // 2
            log.warning("not enough memory for %d %s at once: %d now", len(batch), name, size)
    return found


@dataclass(frozen=True, eq=False)
class Network:
    """Weights on a device, in evaluation mode.

    Attributes
    ----------
    load_module : callable
        Returns the network in torch, float32, on the device; called when it is first needed.
    card : WeightsCard
        Architecture, label space, sensor and origin of the weights.
    sensor : Sensor
        Geometry and normalisation of the range images: the card's unless another was asked for.
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` …
    precision : {"float32", "bfloat16", "float16"}
        Number type that the engine computes in.
    engine : {"openvino", "torch"}
        Library that computes; OpenVINO needs `sha256`.
    weights : str
        Name of the weights file, for errors.
    sha256 : str, optional
        Of the weights file; None for weights that no file holds as they are.
    merging : ClassMerging, optional
        Merges the classes of the card into those of all results but the logits.
    """

    load_module: Callable[[], "SegmentationNetwork"]
    card: WeightsCard
    sensor: Sensor
    device: str = "cpu"
    precision: str = "float32"
    engine: str = "torch"
    weights: str = "the weights"
    sha256: str | None = None
    merging: ClassMerging | None = None

    @property
    def space(self) -> LabelSpace:
        """Classes of the results: those of the card, merged if that was asked for."""
        return self.card.space if self.merging is None else self.merging.space

    @property
    def groups(self) -> tuple[tuple[int, ...], ...] | None:
        """Train ids of the card that are merged into each class, None if none are."""
        return None if self.merging is None else self.merging.groups

    @cached_property
    def module(self) -> "SegmentationNetwork":
        """Network in torch: (B, 5, H, W) normalised range images to (B, C, H, W) logits."""
        return self.load_module()

    @cached_property
    def torch_module(self) -> "SegmentationNetwork":
        """Network in torch that computes in the precision; float32 in and out."""
        import torch

        from salsanext_cli.engines.torch_engine import in_precision

        if self.precision == "float32":
            return self.module
        return in_precision(self.module, getattr(torch, self.precision))

    @cached_property
    def _graphs(self) -> dict[Any, Graph]:
        return {}

    @cached_property
    def batch_sizes(self) -> dict[str, int]:
        """Number of items by name that there was room for at once; empty until memory runs out."""
        return {}

    def graph(
        self,
        name: str,
        function: Callable[..., Any],
        inputs: Callable[[], "Sequence[Tensor]"],
        *,
        precision: str | None = None,
        streams: int = 1,
    ) -> Graph:
        """Return a function of the network as an OpenVINO graph for the sensor's images.

        Parameters
        ----------
        name : str
            Of the function.
        function : callable
            Takes the module and tensors, returns tensors.
        inputs : callable
            Returns tensors of the shapes that the function takes.
        precision : str, optional
            Number type, if not the network's.
        streams : int
            Calls that are computed side by side.
        """
        key = (name, self.sha256, self.sensor.height, self.sensor.width)
        settings = (precision or self.precision, thread_count(), streams)
        # Each thread has its own: a graph computes one thing at a time.
        place = (name, settings, threading.get_ident())
        if place not in self._graphs:
            self._graphs[place] = compiled_graph(
                lambda: converted(self.module, function, inputs()), key, *settings
            )
        return self._graphs[place]

    def input_array(self, channels: Float) -> Float:
        """Return (5, H, W) channels as the network takes them, (1, 5, H, W).

        Gaps and intensity become those of training where both sensors know theirs.
        """
        own, trained = (s.intensity_quantiles for s in (self.sensor, self.card.sensor))
        if own and trained:
            channels = match_intensity(channels, own, trained)
        channels = with_filled_gaps(channels, self.sensor, self.card.sensor)
        return normalise(channels, self.sensor)[None]

    def input(self, channels: Float) -> "Tensor":
        """Return what `input_array` does as a tensor on the device."""
        import torch

        normalised = torch.from_numpy(self.input_array(channels))
        return normalised.to(self.device, memory_format=torch.channels_last)

    def example_input(self) -> "Tensor":
        """Return an empty range image, (1, 5, H, W)."""
        import torch

        return torch.zeros(1, 5, self.sensor.height, self.sensor.width)

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32, of the classes of the card."""
        (logits,) = self._computed([image.channels], "logits", lambda logits: logits)
        return logits

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
        self.require_finite(probabilities, source)
        return probabilities

    def pixel_probabilities(self, channels: Sequence[Float]) -> list[Float]:
        """Return the softmax of every pixel of some range images, as `probabilities` does.

        OpenVINO computes one after the other, so that no bit depends on the others; torch computes
        all together, half as many where memory runs out.

        Parameters
        ----------
        channels : sequence of (5, H, W) float32
            Of range images of the network's sensor.

        Raises
        ------
        MemoryError
            If there is no room for a single one.
        """
        return [self.merged(softmax) for softmax in self.card_probabilities(channels)]

    def merged(self, probabilities: Float) -> Float:
        """Add the probabilities of classes that are merged, if any are: (C, …) to (K, …)."""
        return probabilities if self.merging is None else self.merging.add(probabilities)

    def card_probabilities(
        self, channels: Sequence[Float], temperature: float | None = None
    ) -> list[Float]:
        """Return the softmax of every pixel of some range images, of the classes of the card."""
        at = temperature or self.card.temperature
        name = f"softmax at {at}"
        return self._computed(channels, name, lambda logits: (logits / at).softmax(dim=1))

    def _computed(
        self, channels: Sequence[Float], name: str, last: Callable[["Tensor"], "Tensor"]
    ) -> list[Float]:
        """Return (C, H, W) of each range image: a function of the logits (B, C, H, W)."""
        if self.engine == "openvino":
            compiled = self.graph(name, lambda m, x: last(m(x)), lambda: [self.example_input()])
            return [compiled(self.input_array(image))[0][0] for image in channels]
        import torch

        from salsanext_cli.engines.torch_engine import inference_mode

        def batch(images: Sequence[Float]) -> Iterable[Float]:
            with inference_mode(self.device):
                logits = self.torch_module(torch.cat([self.input(image) for image in images]))
                return last(logits).cpu().numpy()

        return self.in_batches(batch, channels, len(channels), "scans")

    def in_batches(
        self,
        function: Callable[[Sequence[Item]], Iterable[Result]],
        items: Sequence[Item],
        most: int,
        name: str,
    ) -> list[Result]:
        """Return the results of a function of batches; `halved_batches` takes the same."""
        return halved_batches(function, items, most, name, self.batch_sizes)

    def require_finite(self, probabilities: Float, source: object) -> None:
        """Raise `WeightsError`, naming weights and scan, if a softmax is not finite."""
        if not np.isfinite(probabilities).all():
            found = f"their logits for {source} are not finite"
            raise WeightsError(self.weights, found, "finite logits", "use other weights")
