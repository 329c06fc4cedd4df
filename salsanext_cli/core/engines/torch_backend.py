# SPDX-License-Identifier: MIT
"""Backend that computes with torch, on GPUs and where OpenVINO does not run.

In a shorter number type, the layers of the range image stay float32, because eight bits of a range
are metres. So do the logits.
"""

import copy
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any, ClassVar, cast

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.core.classes.merging import ClassMerging
from salsanext_cli.core.engines.backend import LOGITS, DeviceBackend, PixelPrediction
from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.cuda_graphs import CudaGraphs
from salsanext_cli.core.engines.device import MAX_BATCH_PIXELS
from salsanext_cli.core.engines.device_copies import HostCopies, pinned
from salsanext_cli.core.engines.dropout_passes import dropout_rates, rest_with_factors
from salsanext_cli.core.engines.moments import SoftmaxSpread
from salsanext_cli.core.network.dropout import random_masks
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS, Float

MAX_GRAPH_PIXELS = 4 * 64 * 2048
"""Most pixels of a batch for which a CUDA graph is tried, which takes the memory of a batch.

On an H200, launching a network takes 4.7 ms. In float16, so do 2.5 images of 64 × 2048 pixels.
"""
NEWER_SETTINGS = "Please use the new API settings to control TF32"
"""Beginning of a warning of torch 2.9 and 2.10."""


@cache
def set_up_cuda() -> None:
    """Let cuDNN compute reproducible bits in full float32, in this process."""
    # Threads share these settings, so a context for each call would affect other threads.
    torch.backends.cudnn.benchmark = False
    torch.backends.cudnn.deterministic = True
    # Some versions of torch name newer settings here, after which `cudnn.flags` raises an error.
    warnings.filterwarnings("ignore", NEWER_SETTINGS)
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cuda.matmul.allow_tf32 = False


@dataclass(frozen=True, eq=False)
class TorchBackend(DeviceBackend):
    """Weights as a torch module. Results are reduced on the device and copied to the host once.

    Attributes
    ----------
    records : bool
        Whether calls of few pixels on a GPU are recorded as CUDA graphs.
    """

    library: ClassVar[str] = "torch"

    records: bool = True

    def __post_init__(self) -> None:
        if self._on_gpu:
            set_up_cuda()

    @property
    def _on_gpu(self) -> bool:
        return self.device != "cpu"

    @cached_property
    def torch_module(self) -> SegmentationNetwork:
        """Network in torch that computes in the precision; float32 in and out."""
        if self.precision == "float32":
            return self.module
        return in_precision(self.module, getattr(torch, self.precision))

    @cached_property
    def _side_by_side(self) -> BatchSize:
        """Number of passes or noisy copies of a scan in a batch."""
        pixels = self.size[0] * self.size[1]
        return BatchSize(max(1, MAX_BATCH_PIXELS // pixels) if self._on_gpu else 1, "passes")

    @cached_property
    def _graphs(self) -> CudaGraphs:
        return CudaGraphs()

    @cached_property
    def _rates(self) -> list[tuple[int, float]]:
        """Channels and rate of each dropout, in the order of computation."""
        image = np.zeros((1, len(CHANNELS), *self.size), np.float32)
        return dropout_rates(self.torch_module, self._padded_trunk(self.tensor([image])))

    @torch.inference_mode()
    def predict(
        self, images: Sequence[Float], temperature: float, *, softmax: bool = False
    ) -> list[PixelPrediction]:
        """Predict the pixels of images, their logits divided by a temperature."""
        probabilities = self.softmax(self.tensor(images), temperature)
        largest, classes = probabilities.max(dim=1)
        reduced = [classes.to(torch.uint8), largest]
        if softmax:
            labels, confidence, copies = self.to_host([*reduced, probabilities])
            return list(map(PixelPrediction, labels, confidence, copies))
        labels, confidence = self.to_host(reduced)
        return list(map(PixelPrediction, labels, confidence))

    @torch.inference_mode()
    def softmax(self, images: Tensor, temperature: float) -> Tensor:
        """Return the softmax (B, C, H, W) of inputs (B, 5, H, W) on the device.

        Their logits are divided by a temperature.
        """
        return (self._logits(images) / temperature).softmax(dim=1)

    @torch.inference_mode()
    def logits(self, images: Sequence[Float]) -> list[Float]:
        """Return the logits (C, H, W) float32 of images."""
        (logits,) = self.to_host([self._logits(self.tensor(images))])
        return list(logits)

    @torch.inference_mode()
    def device_logits(self, images: Tensor) -> Tensor:
        """Return the logits (B, C, H, W) float32 of inputs (B, 5, H, W) on the device."""
        return self._logits(images)

    @torch.inference_mode()
    def sample(
        self, image: Float, seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> SoftmaxSpread:
        """Return the spread of the softmax over dropout passes, one per seed of the masks."""
        spread = self.device_sample(self.tensor([image]), seeds, merging)
        arrays = self.to_host(list(spread.values()))
        return SoftmaxSpread(**dict(zip(spread, arrays, strict=True)))

    @torch.inference_mode()
    def device_sample(
        self, image: Tensor, seeds: Sequence[int], merging: ClassMerging | None = None
    ) -> dict[str, Tensor]:
        """Return the attributes of `SoftmaxSpread` on the device, without waiting for it."""
        features = self._padded_trunk(image)
        height, width = image.shape[-2:]

        def passes(batch: Sequence[int]) -> tuple[Tensor, Tensor | None]:
            draw = random_masks([torch.Generator().manual_seed(seed) for seed in batch])
            factors = self._on_device([draw(*rate) for rate in self._rates])
            repeated = [tensor.expand(len(batch), -1, -1, -1) for tensor in features]
            softmax, nats = self._call(
                "rest", rest_with_factors, self.torch_module, *repeated, *factors
            )
            return softmax[..., :height, :width], nats[..., :height, :width]

        total, squares, nats = self._sums(passes, seeds, merging)
        mean = total / len(seeds)
        variance = (squares / len(seeds) - mean.square()).clamp_(min=0)
        entropy = torch.special.entr(mean).sum(dim=0).clamp_(min=0)
        information = (entropy - nats / len(seeds)).clamp_(min=0)
        results = {
            "mean": mean,
            "variance": variance,
            "epistemic": variance.mean(dim=0),
            "entropy": entropy,
            "mutual_information": information,
        }
        return {name: values.float() for name, values in results.items()}

    @torch.inference_mode()
    def spread(self, images: Iterable[Float], merging: ClassMerging | None = None) -> Float:
        """Return the unbiased variance of the softmax over images, (C, H, W) float32."""

        def softmax(batch: Sequence[Float]) -> tuple[Tensor, Tensor | None]:
            return self.softmax(self.tensor(batch), 1.0), None

        (variance,) = self.to_host([self._unbiased_variance(softmax, list(images), merging)])
        return cast(Float, variance)

    @torch.inference_mode()
    def device_spread(self, images: Tensor, merging: ClassMerging | None = None) -> Tensor:
        """Return the result of `spread` on the device, of inputs (B, 5, H, W) there."""

        def softmax(batch: Sequence[Tensor]) -> tuple[Tensor, Tensor | None]:
            return self.softmax(torch.cat(list(batch)), 1.0), None

        return self._unbiased_variance(softmax, torch.split(images, 1), merging)

    @torch.inference_mode()
    def run(
        self, name: str, function: Callable[..., Any], *images: Float, exact: bool = False
    ) -> tuple[Tensor, ...]:
        """Return ``function(module, *images)``, tensors on the device."""
        tensors = [self.tensor([image]) for image in images]
        return self.device_run(name, function, *tensors, exact=exact)

    @torch.inference_mode()
    def device_run(
        self, name: str, function: Callable[..., Any], *images: Tensor, exact: bool = False
    ) -> tuple[Tensor, ...]:
        """Return the result of `run` of tensors (1, …) on the device."""
        module = self.module if exact else self.torch_module
        return self._call(f"{name}, exact: {exact}", function, module, *images)

    def tensor(self, images: Sequence[Float]) -> Tensor:
        """Return images (1, 5, H, W) as a tensor (B, 5, H, W) on the device."""
        batch = pinned(torch.from_numpy(np.concatenate(images)), self.device)
        return batch.to(self.device, memory_format=torch.channels_last, non_blocking=True)

    def _on_device(self, factors: Sequence[Tensor]) -> Sequence[Tensor]:
        """Return factors (B, C) of several dropouts on the device, by one copy without waiting."""
        packed = pinned(torch.cat([*factors], dim=1), self.device)
        channels = [tensor.shape[1] for tensor in factors]
        return torch.split(packed.to(self.device, non_blocking=True), channels, dim=1)

    def _logits(self, images: Tensor) -> Tensor:
        """Return the logits (B, C, H, W) of inputs (B, 5, H, W) on the device."""
        (logits,) = self._call("logits", _forward, self.torch_module, images)
        return logits

    def _padded_trunk(self, images: Tensor) -> tuple[Tensor, ...]:
        """Return the features in front of the first dropout, of inputs (B, 5, H, W)."""
        return self._call("trunk", SegmentationNetwork.padded_trunk, self.torch_module, images)

    def _call(
        self, name: str, function: Callable[..., Any], module: nn.Module, *inputs: Tensor
    ) -> tuple[Tensor, ...]:
        """Return ``function(module, *inputs)``; on a GPU, a call of few pixels is one launch.

        `name` identifies the function.
        """
        call = partial(function, module)
        pixels = len(inputs[0]) * self.size[0] * self.size[1]
        if self._on_gpu and self.records and pixels <= MAX_GRAPH_PIXELS:
            return self._graphs.call(name, call, *inputs)
        outputs: tuple[Tensor, ...] = call(*inputs)
        return outputs

    def to_host(self, tensors: Sequence[Tensor]) -> list[Any]:
        """Return tensors as arrays, copied together; wait for the device once."""
        arrays = HostCopies.of(tensors).arrays()
        # Systems have little of the page-locked memory of the copies from a GPU.
        return [array.copy() for array in arrays] if self._on_gpu else arrays

    def _unbiased_variance(
        self,
        compute: Callable[[Sequence[Any]], tuple[Tensor, Tensor | None]],
        items: Sequence[Any],
        merging: ClassMerging | None,
    ) -> Tensor:
        """Return the unbiased variance of the softmax, (C, H, W) float32; arguments as `_sums`."""
        count = len(items)
        total, squares, _ = self._sums(compute, items, merging)
        variance = (squares / count - (total / count).square()).clamp_(min=0)
        return (variance * (count / (count - 1))).float()

    def _sums(
        self,
        compute: Callable[[Sequence[Any]], tuple[Tensor, Tensor | None]],
        items: Sequence[Any],
        merging: ClassMerging | None,
    ) -> list[Tensor]:
        """Return sums of the softmax over items, of its squares and of its entropies, float64.

        Parameters
        ----------
        compute : callable
            Function of a batch of items to their softmax (B, C, H, W) and entropies (B, H, W).
        items : sequence
            Seeds of passes, or images.
        merging : ClassMerging, optional
            Merging of the classes.

        Returns
        -------
        list of Tensor
            (C, H, W), (C, H, W) and (H, W) on the device.
        """

        def add_up(batch: Sequence[Any]) -> list[Tensor]:
            softmax, nats = compute(batch)
            if merging is not None:
                softmax = merged(softmax, merging)
                nats = None if nats is None else torch.special.entr(softmax).sum(dim=1)
            exact = softmax.double()
            nats = exact.new_zeros(exact[:, 0].shape) if nats is None else nats.double()
            return [values.sum(dim=0) for values in (exact, exact.square(), nats)]

        batches = self._side_by_side.in_batches(add_up, items)
        total = next(batches)
        for sums in batches:
            for tensor, more in zip(total, sums, strict=True):
                tensor.add_(more)
        return total


def _forward(module: SegmentationNetwork, images: Tensor) -> tuple[Tensor]:
    return (module(images),)


def merged(softmax: Tensor, merging: ClassMerging) -> Tensor:
    """Add the probabilities of merged classes, (B, C, H, W) to (B, K, H, W)."""
    size = (len(softmax), merging.space.class_count, *softmax.shape[2:])
    result = softmax.new_zeros(size)
    for target, probability in zip(merging.targets, softmax.unbind(dim=1), strict=True):
        result[:, target] += probability
    # Rounded sums may exceed 1.
    return result.clamp_(max=1)


class Float32Convolution(nn.Conv2d):
    """Float32 convolution from and into features of any type, also within autocast.

    It shares weight and bias with another convolution.
    """

    def __init__(self, layer: nn.Conv2d, output: torch.dtype) -> None:
        # On "meta" no weights are drawn: torch's global generator does not change.
        super().__init__(
            layer.in_channels,
            layer.out_channels,
            layer.kernel_size,  # type: ignore[arg-type]
            layer.stride,  # type: ignore[arg-type]
            layer.padding,  # type: ignore[arg-type]
            layer.dilation,  # type: ignore[arg-type]
            layer.groups,
            device="meta",
        )
        self.weight = layer.weight
        self.bias = layer.bias
        self.output = output
        self.train(layer.training)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in, H, W) of any type to (B, out, H, W) of `output`, within its range."""
        with torch.autocast(x.device.type, enabled=False):
            features: Tensor = super().forward(x.float())
        if self.output == torch.float32:
            return features
        border = torch.finfo(self.output)
        return features.clamp(border.min, border.max).to(self.output)


def keep_ends_in_float32(module: nn.Module, hidden: torch.dtype = torch.float32) -> None:
    """Compute the layers of the range image, into `hidden` features, and the logits in float32."""
    for name, layer in list(module.named_modules()):
        is_plain = type(layer) in (nn.Conv2d, Float32Convolution)
        if is_plain and (name == LOGITS or layer.in_channels == len(CHANNELS)):
            parent, _, attribute = name.rpartition(".")
            output = torch.float32 if name == LOGITS else hidden
            setattr(module.get_submodule(parent), attribute, Float32Convolution(layer, output))


def in_precision(module: SegmentationNetwork, dtype: torch.dtype) -> SegmentationNetwork:
    """Return a copy of a network that computes in a shorter type, float32 in and out."""
    short = copy.deepcopy(module).eval()
    keep_ends_in_float32(short, dtype)
    for layer in short.modules():
        if not isinstance(layer, Float32Convolution) and not list(layer.children()):
            layer.to(dtype)
    return short.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
