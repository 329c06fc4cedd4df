# SPDX-License-Identifier: MIT
"""Batch-norm statistics re-estimated on scans without labels (Li et al., arXiv 1603.04779).

A convolution's values depend on the sensor and on the place. Batch norm takes off their mean and
divides by their deviation, those of the scans that it was trained on; the statistics of other scans
undo part of what is different there (Schneider et al., arXiv 2006.16971).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.hooks import RemovableHandle

from salsanext_cli.engines.network import Network
from salsanext_cli.errors import FormatError, UsageError, WeightsError, counted
from salsanext_cli.fitting.label_scan import project_for
from salsanext_cli.fitting.scan_fit import EGO
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.records import Float
from salsanext_cli.training.tuning.scans import Tuned, TuningScans

DEFAULT_SHARE = 0.1
"""Share of the statistics of the scans: larger ones lower the accuracy or the mean IoU on one of
three sensors (docs/tune.md)."""

log = logging.getLogger(__name__)


def fit_batchnorm(scans: TuningScans, share: float = DEFAULT_SHARE) -> Tuned:
    """Move the statistics of batch norm towards those of scans of one's own.

    Reports of every batch norm, in order of computation, means over its channels: `shift`, of the
    mean in old standard deviations, and `variance_ratio`, new to old, ε added to both (geometric).
    """
    if not 0 < share <= 1:
        raise UsageError("--share", f"{share:g}", "above 0, at most 1")
    if not norms(scans.loaded.module):
        name = scans.loaded.engine.name
        raise WeightsError(name, "its network has no batch norm", "one with it")
    network = scans.network
    layers = norms(network.module)
    old = {name: Statistics.kept_by(layer) for name, layer in layers.items()}
    pooled: dict[str, Statistics] = {}
    summary = RunSummary(network.sensor)
    for file in scans.each():
        projected = project_for(network, file)
        image = projected.image
        summary.add(ScanSummary(file, projected.check))
        if not (image.pixel_of_point >= 0).any():
            none = f"none of its {len(image.pixel_of_point)} points has a pixel"
            raise FormatError(file.path, none, "points that were measured, in view of the sensor")
        own = statistics_of_scan(network, image.channels, share, file.path)
        pooled = {name: pooled[name] + new if pooled else new for name, new in own.items()}
        log.info("%s: done", file.name)
    new = {name: old[name].blended(each, share) for name, each in pooled.items()}
    sensor, trained = network.sensor, network.card.sensor
    scanned = counted(len(scans.files), "scan")
    done = f"Batch norm re-estimated on {scanned} of {sensor.name}, share {share:g}."
    # Later scans are matched and filled as these were.
    known = trained.intensity_quantiles if sensor.intensity_quantiles else ()
    sensor = replace(sensor, intensity_quantiles=known, row_gaps=trained.row_gaps)
    # The mounting is that of these scans, not of those that the weights will be used for.
    sensor = replace(sensor, **{name: getattr(trained, name) for name in ("up", "origin", *EGO)})
    report = {
        "scans": len(scans.files),
        "share": share,
        "sensor": sensor.name,
        "layers": [_moved(name, old[name], new[name], layers[name].eps) for name in new],
        "warnings": summary.finished().warnings(),
    }
    card = replace(network.card.changed(done), sensor=sensor)
    return Tuned(card, report, as_tensors(new))


def _moved(layer: str, old: Statistics, new: Statistics, eps: float) -> dict[str, Any]:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return {"layer": layer, "shift": float(shift), "variance_ratio": math.exp(ratio)}


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
