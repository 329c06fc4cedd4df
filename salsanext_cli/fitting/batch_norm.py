# SPDX-License-Identifier: MIT
"""Batch-norm statistics of scans that carry no labels (Li et al., arXiv 1603.04779).

A convolution's values depend on the sensor and on the place. Batch norm takes off their mean and
divides by their deviation, those of the scans that it was trained on; the statistics of other scans
undo part of what is different there (Schneider et al., arXiv 2006.16971).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.hooks import RemovableHandle

from salsanext_cli.engines.network import Network
from salsanext_cli.errors import WeightsError
from salsanext_cli.records import Float


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Mean and variance of each channel; adding two gives those of both together."""

    count: float  # Values per channel
    # (C,) float64: of these values; the variance is that of the population, divided by `count`
    mean: Tensor
    variance: Tensor

    def __add__(self, other: Statistics) -> Statistics:
        count = self.count + other.count
        share = other.count / count
        apart = other.mean - self.mean
        # Variance within either, and between their means: no squares of large means are subtracted.
        within = (1 - share) * self.variance + share * other.variance
        between = share * (1 - share) * apart.square()
        return Statistics(count, self.mean + share * apart, within + between)

    @classmethod
    def of(cls, values: Tensor, cells: Tensor) -> Statistics:
        """Return those of values (C, h, w), each counted as often as `cells` (h, w) says."""
        double, count = values.double(), cells.sum()
        mean = torch.einsum("chw,hw->c", double, cells) / count
        apart = (double - mean[:, None, None]).square()
        return cls(float(count), mean, torch.einsum("chw,hw->c", apart, cells) / count)

    @classmethod
    def kept_by(cls, layer: nn.BatchNorm2d) -> Statistics:
        """Return the statistics of a layer at inference; their count is unknown, hence 0."""
        mean, variance = layer.get_buffer("running_mean"), layer.get_buffer("running_var")
        return cls(0.0, mean.double(), variance.double())

    def blended(self, new: Statistics, share: float) -> Statistics:
        """Return these statistics moved towards new ones: (1 − share) · these + share · new."""
        mean = torch.lerp(self.mean, new.mean, share)
        return Statistics(new.count, mean, torch.lerp(self.variance, new.variance, share))


def norms(module: nn.Module) -> dict[str, nn.BatchNorm2d]:
    """Return the batch-norm layers of a network that keep statistics, by name."""
    return {
        name: layer
        for name, layer in module.named_modules()
        if isinstance(layer, nn.BatchNorm2d) and layer.track_running_stats
    }


def require_norms(network: Network) -> None:
    """Raise `WeightsError` if a network has no batch norm."""
    if not norms(network.module):
        found = "its network has no batch norm"
        raise WeightsError(network.engine.name, found, "one with batch norm")


@dataclass(slots=True, eq=False)
class PooledStatistics:
    """Statistics of several scans together: the variance within the scans and between them."""

    network: Network  # Stays as it is
    share: float  # As `statistics_of_scan` takes it
    _pooled: dict[str, Statistics] = field(default_factory=dict)

    def add(self, channels: Float, source: object = "a scan") -> None:
        """Add a scan; parameters and errors as of `statistics_of_scan`."""
        own = statistics_of_scan(self.network, channels, self.share, source)
        before = self._pooled
        self._pooled = {name: before[name] + new if before else new for name, new in own.items()}

    def moved(self) -> dict[str, Statistics]:
        """Return the statistics of the network, moved by the share towards those of the scans."""
        layers = norms(self.network.module)
        return {
            name: Statistics.kept_by(layers[name]).blended(new, self.share)
            for name, new in self._pooled.items()
        }


@torch.inference_mode()
def statistics_of_scan(
    network: Network, channels: Float, share: float = 1.0, source: object = "a scan"
) -> dict[str, Statistics]:
    """Return the statistics of each batch norm's input when a scan passes, by its name, in order.

    Each layer normalises with its old statistics moved by `share` towards the scan's, as in a
    network adapted to this scan alone, so that a layer sees what the layers before it make of the
    scan once they are adapted. Dropout is off.

    As in training, empty pixels count: the convolutions spread what surrounds them into them. The
    padding of `SegmentationNetwork.pad` does not count; a cell that lies partly on it counts by the
    share of its area that is image.

    `channels` (5, H, W); `source`: what to call the scan in an error.
    """
    module = network.module
    inputs = network.engine.tensor(network.input(channels))
    height, width = inputs.shape[-2:]
    inside = torch.zeros(module.pad(inputs).shape[-2:], dtype=torch.float64)
    inside[:height, :width] = 1
    inside = inside.to(network.device)
    statistics: dict[str, Statistics] = {}

    def hook(name: str, layer: nn.BatchNorm2d) -> RemovableHandle:
        def normalise(_: nn.Module, given: tuple[Tensor], __: Tensor) -> Tensor:
            (values,) = given
            cells = F.adaptive_avg_pool2d(inside[None], (values.shape[2], values.shape[3]))[0]
            own = statistics[name] = Statistics.of(values[0], cells)
            used = Statistics.kept_by(layer).blended(own, share)
            mean, variance = used.mean.to(values.dtype), used.variance.to(values.dtype)
            return F.batch_norm(values, mean, variance, layer.weight, layer.bias, eps=layer.eps)

        return layer.register_forward_hook(normalise)

    handles = [hook(name, layer) for name, layer in norms(module).items()]
    try:
        module(inputs)
    finally:
        for handle in handles:
            handle.remove()
    for name, values in as_tensors(statistics).items():
        if not torch.isfinite(values).all():
            raise WeightsError(source, f"the network's {name} is not finite", "finite values")
    return statistics


def as_tensors(statistics: Mapping[str, Statistics]) -> dict[str, Tensor]:
    """Return statistics as a weights file holds them, float32, by the name of the tensor."""
    return {
        f"{layer}.{name}": values.float().cpu()
        for layer, new in statistics.items()
        for name, values in (("running_mean", new.mean), ("running_var", new.variance))
    }
