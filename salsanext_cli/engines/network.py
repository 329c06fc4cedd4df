# SPDX-License-Identifier: MIT
"""Weights on a device, and a network ready to use: range image in, probabilities out."""

import logging
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.compiled import thread_count
from salsanext_cli.engines.graphs import compiled_graph, converted
from salsanext_cli.errors import WeightsError, out_of_memory
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.network_input import network_input
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.options import KnnParameters
from salsanext_cli.records import CHANNELS, Float, RangeImage
from salsanext_cli.sensors.sensor import Sensor

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.network.segmentation import SegmentationNetwork

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)


class Graph:
    """Compiled part of a network: float32 arrays in, float32 arrays out, the same bits always."""

    def __init__(self, compiled: Any) -> None:
        self.compiled = compiled
        self.request = compiled.create_infer_request()

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the inputs."""
        return [tuple(port.shape) for port in self.compiled.inputs]

    def __call__(self, *inputs: Float) -> list[Float]:
        """Compute once."""
        outputs = self.request.infer(dict(enumerate(inputs)), share_inputs=True)
        return list(outputs.values())

    def each(self, calls: Sequence[Sequence[Float]]) -> list[list[Float]]:
        """Compute several times side by side; return the outputs in the order of the calls."""
        from openvino import AsyncInferQueue

        outputs: list[list[Float]] = [[]] * len(calls)

        def keep(request: Any, number: int) -> None:
            outputs[number] = [tensor.data.copy() for tensor in request.output_tensors]

        queue = AsyncInferQueue(self.compiled)
        queue.set_callback(keep)
        for number, inputs in enumerate(calls):
            queue.start_async(dict(enumerate(inputs)), number, share_inputs=True)
        queue.wait_all()
        return outputs


@dataclass(frozen=True, eq=False)
class Engine:
    """Weights on a device, in evaluation mode; it knows images, not scans."""

    # Returns the network in torch, float32, on the device; called when it is first needed
    load_module: "Callable[[], SegmentationNetwork]"
    card: WeightsCard
    size: tuple[int, int]  # Rows and columns of the range images
    device: str = "cpu"  # "cpu", "cuda", "cuda:1" …
    precision: str = "float32"  # "float32", "bfloat16" or "float16"
    library: str = "torch"  # "openvino", which needs `sha256`, or "torch"
    name: str = "the weights"  # Of the weights file, for errors
    sha256: str | None = None  # Of the weights file; None for weights that no file holds
    code: str = ""  # Digest of the code of a plug-in's network
    graphs: dict[Any, Graph] = field(default_factory=dict, repr=False)  # Compiled so far
    # Number of items by name that there was room for at once; empty until memory runs out
    batch_sizes: dict[str, int] = field(default_factory=dict, repr=False)

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

    def graph(
        self,
        name: str,
        function: Callable[..., Any],
        inputs: "Callable[[], Sequence[Tensor]] | None" = None,
        *,
        precision: str | None = None,
        streams: int = 1,
    ) -> Graph:
        """Return a named function of the module and tensors as a graph for images of the size.

        `inputs` returns tensors of the shapes that it takes, by default one image; `precision` is
        the engine's by default; `streams` calls are computed side by side.
        """

        def make() -> Any:
            return converted(self.module, function, inputs() if inputs else [self.example_input()])

        return self.compiled(name, make, precision or self.precision, streams)

    def compiled(
        self, name: str, make: Callable[[], Any], precision: str, streams: int = 1
    ) -> Graph:
        """Return a model that is compiled once for each thread, as `compiled_graph` does."""
        settings = (precision, thread_count(), streams)
        key = (name, settings, threading.get_ident())
        if key not in self.graphs:
            depends = (name, self.sha256, *self.size, *filter(None, [self.code]))
            model = compiled_graph(make, depends, *settings)
            self.graphs[key] = Graph(model)
        return self.graphs[key]

    def example_input(self) -> "Tensor":
        """Return an empty range image, (1, 5, H, W)."""
        import torch

        return torch.zeros(1, len(CHANNELS), *self.size)

    def tensor(self, image: Float) -> "Tensor":
        """Return a normalised range image (1, 5, H, W) as a tensor on the device."""
        import torch

        return torch.from_numpy(image).to(self.device, memory_format=torch.channels_last)

    def outputs(self, images: Sequence[Float], temperature: float | None) -> list[Float]:
        """Return the softmax (C, H, W) float32 at a temperature, or the logits, of each image.

        They are normalised, (1, 5, H, W). OpenVINO computes one after the other, so that no bit
        depends on the others; torch computes all together, half as many where memory runs out, and
        raises `MemoryError` if there is no room for one.
        """
        if self.library == "openvino":
            compiled = self.output_graph(temperature)
            return [compiled(image)[0][0] for image in images]
        import torch

        from salsanext_cli.engines.torch_engine import inference_mode

        def batch(part: Sequence[Float]) -> Iterable[Float]:
            with inference_mode(self.device):
                logits = self.torch_module(torch.cat([self.tensor(image) for image in part]))
                return _of_logits(logits, temperature).cpu().numpy()

        return self.in_batches(batch, images, len(images), "scans")

    def output_graph(self, temperature: float | None) -> Graph:
        """Return the graph of the softmax at a temperature, or of the logits."""
        name = "logits" if temperature is None else f"softmax at {temperature}"
        return self.graph(name, lambda module, x: _of_logits(module(x), temperature))

    def in_batches(
        self,
        function: Callable[[Sequence[Item]], Iterable[Result]],
        items: Sequence[Item],
        most: int,
        name: str,
    ) -> list[Result]:
        """Return results of a function of batches of `most` items, halved where memory runs out."""
        results: list[Result] = []
        while len(results) < len(items):
            size = min(most, self.batch_sizes.get(name, most))
            batch = items[len(results) : len(results) + size]
            try:
                results.extend(function(batch))
            except (MemoryError, RuntimeError) as error:
                if not out_of_memory(error):
                    raise
                if len(batch) == 1:
                    raise MemoryError(f"no room for one of the {name}") from error
                size = self.batch_sizes[name] = len(batch) // 2
                log.warning("not enough memory for %d %s at once: %d now", len(batch), name, size)
        return results

    def require_finite(self, values: Float, source: object) -> None:
        """Raise `WeightsError`, naming weights and scan, if a result is not finite."""
        if not np.isfinite(values).all():
            wrong = f"their logits for {source} are not finite"
            raise WeightsError(self.name, wrong, "finite logits", "use other weights")


def _of_logits(logits: "Tensor", temperature: float | None) -> "Tensor":
    return logits if temperature is None else (logits / temperature).softmax(dim=1)


@dataclass(frozen=True, eq=False)
class Network:
    """Weights on a device, fitted to the sensor of the scans at hand.

    Attributes
    ----------
    engine : Engine
        Computes with the weights.
    sensor : Sensor
        Geometry and normalisation of the range images: the card's unless another was named.
    merging : ClassMerging, optional
        Merges the classes of the card into those of all results but the logits.
    """

    engine: Engine
    sensor: Sensor
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
    def space(self) -> LabelSpace:
        """Classes of the results: those of the card, merged if that was asked for."""
        return self.card.space if self.merging is None else self.merging.space

    @property
    def groups(self) -> tuple[tuple[int, ...], ...] | None:
        """Train ids of the card that are merged into each class, None if none are."""
        return None if self.merging is None else self.merging.groups

    def for_sensor(self, sensor: Sensor) -> "Network":
        """Return the network for another sensor, whose images have the same size."""
        return replace(self, sensor=sensor)

    def input(self, channels: Float) -> Float:
        """Return (5, H, W) channels of the sensor as the weights take them, (1, 5, H, W)."""
        return network_input(channels, self.sensor, self.card.sensor)

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32, of the classes of the card."""
        (logits,) = self.engine.outputs([self.input(image.channels)], None)
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
        self.engine.require_finite(probabilities, source)
        return probabilities

    def pixel_probabilities(
        self, channels: Sequence[Float], temperature: float | None = None
    ) -> list[Float]:
        """Return the softmax (C, H, W) of range images (5, H, W), as `Engine.outputs` does."""
        return self.softmax([self.input(each) for each in channels], temperature)

    def softmax(self, inputs: Sequence[Float], temperature: float | None = None) -> list[Float]:
        """Return the softmax (C, H, W) of inputs (1, 5, H, W), as `Engine.outputs` does."""
        softmax = self.engine.outputs(inputs, temperature or self.card.temperature)
        return [self.merged(each) for each in softmax]

    def merged(self, probabilities: Float) -> Float:
        """Add the probabilities of classes that are merged, if any are: (C, …) to (K, …)."""
        return probabilities if self.merging is None else self.merging.add(probabilities)

    def labels(
        self, image: RangeImage, scores: Float, knn: KnnParameters = KnnParameters()
    ) -> TrainIds:
        """Return labels of the points, (N,) uint8: the largest score (C, H, W), refined by kNN."""
        return knn_refine(image, scores.argmax(axis=0), len(scores), knn)
