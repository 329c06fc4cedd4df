# SPDX-License-Identifier: MIT
"""Weights on a device: normalised range images in, logits or softmax of every pixel out."""

import logging
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from salsanext_cli.compiled.kernels import thread_count
from salsanext_cli.engines.graphs import Graph, compiled_graph, converted
from salsanext_cli.errors import WeightsError, out_of_memory
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.records import CHANNELS, Float

if TYPE_CHECKING:
    from torch import Tensor

    from salsanext_cli.network.segmentation import SegmentationNetwork

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)


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
        """Return a function of the network as an OpenVINO graph for images of the size.

        `name`: of the function, which takes the module and tensors and returns tensors; `inputs`:
        returns tensors of the shapes that it takes, by default one image; `precision`: if not the
        engine's; `streams`: calls that are computed side by side.
        """
        settings = (precision or self.precision, thread_count(), streams)
        # Each thread has its own: a graph computes one thing at a time.
        place = (name, settings, threading.get_ident())
        if place not in self.graphs:
            made = inputs or (lambda: [self.example_input()])
            self.graphs[place] = compiled_graph(
                lambda: converted(self.module, function, made()),
                (name, self.sha256, *self.size),
                *settings,
            )
        return self.graphs[place]

    def example_input(self) -> "Tensor":
        """Return an empty range image, (1, 5, H, W)."""
        import torch

        return torch.zeros(1, len(CHANNELS), *self.size)

    def tensor(self, image: Float) -> "Tensor":
        """Return a normalised range image (1, 5, H, W) as a tensor on the device."""
        import torch

        return torch.from_numpy(image).to(self.device, memory_format=torch.channels_last)

    def logits(self, image: Float) -> Float:
        """Return the logits (C, H, W) float32 of a normalised range image (1, 5, H, W)."""
        (logits,) = self._outputs([image], None)
        return logits

    def softmax(self, images: Sequence[Float], temperature: float | None = None) -> list[Float]:
        """Return the softmax (C, H, W) float32 of normalised range images (1, 5, H, W).

        The logits are divided by a temperature, by default the card's. OpenVINO computes one image
        after the other, so that no bit depends on the others; torch computes all together, half as
        many where memory runs out, and raises `MemoryError` if there is no room for one.
        """
        return self._outputs(images, temperature or self.card.temperature)

    def _outputs(self, images: Sequence[Float], temperature: float | None) -> list[Float]:
        """Return the softmax at a temperature, or the logits, of each image."""
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
        """Return the results of a function of batches, halved where memory runs out.

        `function`: takes some of the items, yields a result of each; `most`: items at once, as long
        as there is room; `name`: of the items, in the plural.
        """
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
