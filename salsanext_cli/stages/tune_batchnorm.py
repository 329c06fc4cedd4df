# SPDX-License-Identifier: MIT
"""Re-estimate the batch-norm statistics of a network on scans without labels."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from salsanext_cli.errors import FormatError, UsageError, WeightsError
from salsanext_cli.geometry.coverage import CoverageCheck
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.weights import WeightsCard, default_weights, save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.stages.project import read_and_project
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import ScanSelection, select_scans
from salsanext_cli.storage.targets import require_target
from salsanext_cli.training.tuning.batch_norm import Statistics, norms, statistics_of_scan
from salsanext_cli.training.validation import evenly_spaced

SHARE = 0.5
"""Within 0.3 points of the best on real scans of three sensors; see docs/tune.md."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Moved:
    """How far the statistics of a batch norm moved, mean over its channels.

    Attributes
    ----------
    layer : str
        Its name in the network.
    shift : float
        Distance of the new mean from the old one, in old standard deviations.
    variance_ratio : float
        New variance over old, the geometric mean; the layer's ε is added to both.
    """

    layer: str
    shift: float
    variance_ratio: float


@dataclass(frozen=True, slots=True)
class TunedBatchNorm:
    """What re-estimating batch-norm statistics ended with.

    Attributes
    ----------
    scans : int
        How many the statistics are of.
    share : float
        Of the new statistics in what was written.
    sensor : str
        What the weights are for from now on.
    layers : tuple of Moved
        Every batch norm, in order of computation.
    """

    scans: int
    share: float
    sensor: str
    layers: tuple[Moved, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {"stage": "tune batchnorm", **asdict(self)}


def tune_batchnorm(
    source: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    share: float = SHARE,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> TunedBatchNorm:
    """Write a weights file with batch-norm statistics moved towards those of scans of one's own.

    Every scan passes once, as `statistics_of_scan` says; no label is read. The statistics of all
    scans are pooled, the variance within the scans and between them, in float64. Memory does not
    grow with the number of scans.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    target : Path
        The `.safetensors` file to write: all other tensors bit for bit. Its sensor is that of
        `network`; what was measured with the old statistics, `scores`, is left out.
    network : NetworkChoice
        Weights, device and sensor.
    selection : Choice
        Which scans; a limit takes scans that are evenly spaced.
    share : float
        Of the new statistics, above 0 and at most 1; the rest are the old ones.
    overwrite : bool
        Whether the target may exist.
    progress : callable, optional
        Called after each scan.

    Raises
    ------
    SalsanextError
        If a scan cannot be used, or the file cannot be written.
    """
    if not 0 < share <= 1:
        raise UsageError("--share", f"{share:g}", "above 0, at most 1")
    loaded, weights = network.load(), network.weights or default_weights()
    old = {name: Statistics.kept_by(layer) for name, layer in norms(loaded.module).items()}
    if not old:
        raise WeightsError(weights, "its network has no batch norm", "one with batch norm")
    scans = select_scans(source, replace(selection, limit=None), loaded.card.space)
    scans = evenly_spaced(scans, selection.limit or 0)
    require_target(target, overwrite)
    pooled = _pooled(scans, loaded, share, progress)
    new = {name: old[name].blended(statistics, share) for name, statistics in pooled.items()}
    card = _card(loaded, len(scans), share)
    save_with_card(weights, target, card, _tensors(new))
    layers = norms(loaded.module)
    moved = tuple(_moved(name, old[name], new[name], layers[name].eps) for name in new)
    return TunedBatchNorm(len(scans), share, loaded.sensor.name, moved)


def _pooled(
    scans: list[ScanFile], network: Network, share: float, progress: Progress | None
) -> Mapping[str, Statistics]:
    """Return the statistics of all scans together, by layer."""
    pooled: dict[str, Statistics] = {}
    check = CoverageCheck(network.sensor)
    for number, file in enumerate(scans, start=1):
        of_scan = _of_scan(file, network, share, check)
        pooled = {name: pooled[name] + new if pooled else new for name, new in of_scan.items()}
        log.info("%s/%s: done", file.sequence, file.stem)
        if progress:
            progress(number, len(scans))
    check.finish()
    return pooled


def _of_scan(
    file: ScanFile, network: Network, share: float, check: CoverageCheck
) -> Mapping[str, Statistics]:
    image, seen = read_and_project(file, network.sensor, str(network.device))
    if not (image.pixel_of_point >= 0).any():
        found = f"none of its {len(image.pixel_of_point)} points has a pixel"
        raise FormatError(file.path, found, "points that were measured, in view of the sensor")
    check.add(seen)
    of_scan = statistics_of_scan(network, image, share)
    for name, values in _tensors(of_scan).items():
        if not torch.isfinite(values).all():
            raise WeightsError(file.path, f"the network's {name} is not finite", "finite values")
    return of_scan


def _card(network: Network, scans: int, share: float) -> WeightsCard:
    """Return the card with the sensor in use, without scores, and with a word on what was done."""
    sensor = network.sensor
    done = f"Batch norm re-estimated on {scans} scans of {sensor.name}, share {share:g}."
    description = f"{network.card.description} {done}".lstrip()
    return replace(network.card, sensor=sensor, scores={}, description=description)


def _tensors(statistics: Mapping[str, Statistics]) -> dict[str, Tensor]:
    """Return what a weights file holds of the statistics, float32."""
    return {
        f"{layer}.{name}": values.float().cpu()
        for layer, new in statistics.items()
        for name, values in (("running_mean", new.mean), ("running_var", new.variance))
    }


def _moved(layer: str, old: Statistics, new: Statistics, eps: float) -> Moved:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return Moved(layer, float(shift), math.exp(ratio))
