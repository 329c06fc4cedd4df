# SPDX-License-Identifier: MIT
"""Backend that computes with OpenVINO on CPUs, from graphs of the torch module."""

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.compiled import thread_count
from salsanext_cli.core.engines.backend import Backend, PixelPrediction
from salsanext_cli.core.engines.conversion import converted
from salsanext_cli.core.engines.device import multiplies_tiles_of_bytes
from salsanext_cli.core.engines.graphs import Graph, compiled_graph, quantised
from salsanext_cli.core.engines.moments import Moments, SoftmaxSpread
from salsanext_cli.core.records import CHANNELS, Float

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.core.network.segmentation import SegmentationNetwork

PASSES_PER_THREAD = 4  # Passes between two additions of results, in order


@dataclass(frozen=True, eq=False)
class OpenVinoBackend(Backend):
    """Weights compiled for this CPU.

    Images are computed one after the other, so that a result does not depend on its batch.
    """

    library: ClassVar[str] = "openvino"
    needs_module: ClassVar[bool] = False

    graphs: dict[Any, Graph] = field(default_factory=dict, repr=False)  # Compiled so far

    @property
    def sampling_precision(self) -> str:
        """Number type of results that measure small differences: moments of the softmax."""
        return "float32" if self.precision == "int8" else self.precision

    def predict(
        self, images: Sequence[Float], temperature: float, *, softmax: bool = False
    ) -> list[PixelPrediction]:
        """Predict the pixels of images, their logits divided by a temperature."""
        graph = self.output_graph(temperature)
        return [
            PixelPrediction.from_softmax(graph(image, share=True)[0][0], keep=softmax)
            for image in images
        ]

    def logits(self, images: Sequence[Float]) -> list[Float]:
        """Return the logits (C, H, W) float32 of images."""
        graph = self.output_graph(None)
        return [graph(image)[0][0] for image in images]

    def sample(
        self, image: Float, seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> SoftmaxSpread:
        """Return the spread of the softmax over dropout passes, one per seed of the masks."""
        from salsanext_cli.core.network.segmentation import SegmentationNetwork as Module

        trunk = self.graph("trunk", Module.padded_trunk, [image], self.sampling_precision)
        moments = self._no_moments(merging)
        height, width = image.shape[-2:]
        inside = (..., slice(height), slice(width))
        for softmax, nats in self._passes(trunk(image), seeds):
            moments.add(softmax[0][inside], nats[0][inside], merging)
        return moments.spread()

    def spread(self, images: Iterable[Float], merging: ClassMerging | None = None) -> Float:
        """Return the unbiased variance of the softmax over images, (C, H, W) float32."""
        graph = self.output_graph(1.0, self.sampling_precision)
        moments = self._no_moments(merging)
        for image in images:
            moments.add(graph(image, share=True)[0][0], None, merging)
        return moments.unbiased_variance()

    def run(
        self, name: str, function: Callable[..., Any], *images: Float, exact: bool = False
    ) -> "tuple[Tensor, ...]":
        """Return ``function(module, *images)`` of a graph with that name."""
        import torch

        graph = self.graph(name, function, images, "float32" if exact else self.precision)
        return tuple(map(torch.from_numpy, graph(*images)))

    def output_graph(self, temperature: float | None, precision: str | None = None) -> Graph:
        """Return the graph of the softmax at a temperature, or of the logits."""

        def output(module: "SegmentationNetwork", image: "Tensor") -> "Tensor":
            logits: Tensor = module(image)
            return logits if temperature is None else (logits / temperature).softmax(dim=1)

        name = "logits" if temperature is None else f"softmax at {temperature}"
        image = np.zeros((1, len(CHANNELS), *self.size), np.float32)
        return self.graph(name, output, [image], precision or self.precision)

    def graph(
        self, name: str, function: Callable[..., Any], images: Sequence[Float], precision: str
    ) -> Graph:
        """Return a function of the network as a graph.

        Parameters
        ----------
        name : str
            Identifies the function in the cache.
        function : callable
            Function of the network in torch and of tensors.
        images : sequence of (1, …) float32
            Examples of these tensors.
        precision : {"float32", "bfloat16", "int8"}
            Number type of most layers.

        Returns
        -------
        Graph
        """

        def make() -> Any:
            import torch

            model = converted(self.module, function, list(map(torch.from_numpy, images)))
            if precision != "int8":
                return model
            return quantised(model, self.card.int8, self.name, tiles=multiplies_tiles_of_bytes())

        return self._compiled(name, make, precision)

    def _passes(self, features: Sequence[Float], seeds: Sequence[int]) -> Iterator[Sequence[Float]]:
        """Yield softmax (1, C, H, W) and entropy (1, H, W) of each pass, with the padding."""
        import torch

        from salsanext_cli.core.engines.dropout_passes import dropout_factors, rest_with_factors
        from salsanext_cli.core.network.dropout import random_masks, require_dropout

        threads = thread_count()
        rate = require_dropout(self.module)

        def make() -> Any:
            tensors = list(map(torch.from_numpy, features))
            inputs = [*tensors, *dropout_factors(self.module, tensors)]
            return converted(self.module, rest_with_factors, inputs)

        rest = self._compiled("rest", make, self.sampling_precision, threads)
        channels = [port.shape[1] for port in rest.compiled.inputs[len(features) :]]
        size = PASSES_PER_THREAD * threads
        for start in range(0, len(seeds), size):
            calls = []
            for seed in seeds[start : start + size]:
                draw = random_masks([torch.Generator().manual_seed(seed)])
                factors = [draw(count, rate).numpy() for count in channels]
                calls.append([*features, *factors])
            yield from rest.in_parallel(calls)

    def _compiled(
        self, name: str, make: Callable[[], Any], precision: str, streams: int = 1
    ) -> Graph:
        """Return a model, compiled once per thread; `streams` calls run in parallel."""
        threads = thread_count()
        key = (name, precision, threads, streams, threading.get_ident())
        if key not in self.graphs:
            identity = (name, self.sha256, self.code, *self.size)
            model = compiled_graph(make, identity, precision, threads=threads, streams=streams)
            self.graphs[key] = Graph(model)
        return self.graphs[key]

    def _no_moments(self, merging: ClassMerging | None) -> Moments:
        space = self.card.space if merging is None else merging.space
        size = (space.class_count, *self.size)
        return Moments(
            count=0,
            sum=np.zeros(size),
            sum_of_squares=np.zeros(size),
            sum_of_entropies=np.zeros(self.size),
        )
