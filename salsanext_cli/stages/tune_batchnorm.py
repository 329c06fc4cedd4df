# SPDX-License-Identifier: MIT
"""Stage `tune batchnorm`: batch-norm statistics re-estimated on scans without labels."""

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
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.coverage import CoverageCheck, field_of_view_coverage
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import ScanSelection, select_evenly
from salsanext_cli.storage.targets import require_target
from salsanext_cli.training.tuning.batch_norm import Statistics, norms, statistics_of_scan

SHARE = 0.5
"""Share of the new statistics: within 0.3 points of the best on three sensors (docs/tune.md)."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MovedStatistics:
    """Distance that the statistics of a batch norm moved, mean over its channels.

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
    """Result of re-estimating batch-norm statistics.

    Attributes
    ----------
    scans : int
        Number of scans that the statistics are of.
    share : float
        Of the new statistics in the weights written.
    sensor : str
        Sensor of the weights written.
    layers : tuple of MovedStatistics
        Every batch norm, in order of computation.
    """

    scans: int
    share: float
    sensor: str
    layers: tuple[MovedStatistics, ...]

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
        `network`; `scores`, measured with the old statistics, are left out.
    network : NetworkSettings
        Weights, device and sensor.
    selection : ScanSelection
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
    loaded = network.load()
    layers = norms(loaded.module)
    if not layers:
        raise WeightsError(network.path, "its network has no batch norm", "one with batch norm")
    scans = select_evenly(source, selection, loaded.card.space)
    require_target(target, overwrite)
    old = {name: Statistics.kept_by(layer) for name, layer in layers.items()}
    pooled: dict[str, Statistics] = {}
    check = CoverageCheck(loaded.sensor)
    for number, file in enumerate(scans, start=1):
        found = _statistics(file, loaded, share, check)
        pooled = {name: pooled[name] + new if pooled else new for name, new in found.items()}
        log.info("%s/%s: done", file.sequence, file.stem)
        if progress:
            progress(number, len(scans))
    check.finish()
    new = {name: old[name].blended(statistics, share) for name, statistics in pooled.items()}
    sensor = loaded.sensor
    done = f"Batch norm re-estimated on {len(scans)} scans of {sensor.name}, share {share:g}."
    description = f"{loaded.card.description} {done}".lstrip()
    card = replace(loaded.card, sensor=sensor, scores={}, description=description)
    save_with_card(network.path, target, card, _tensors(new))
    moved = tuple(_moved(name, old[name], new[name], layers[name].eps) for name in new)
    return TunedBatchNorm(len(scans), share, sensor.name, moved)


def _statistics(
    file: ScanFile, network: Network, share: float, check: CoverageCheck
) -> Mapping[str, Statistics]:
    """Read and project a scan; return its statistics, by layer."""
    scan = read_scan(file.path, intensity_scale=network.sensor.intensity_scale)
    image = project(scan, network.sensor, str(network.device))
    if not (image.pixel_of_point >= 0).any():
        none = f"none of its {len(image.pixel_of_point)} points has a pixel"
        raise FormatError(file.path, none, "points that were measured, in view of the sensor")
    check.add(field_of_view_coverage(scan, network.sensor))
    found = statistics_of_scan(network, image, share)
    for name, values in _tensors(found).items():
        if not torch.isfinite(values).all():
            raise WeightsError(file.path, f"the network's {name} is not finite", "finite values")
    return found


def _tensors(statistics: Mapping[str, Statistics]) -> dict[str, Tensor]:
    """Return statistics as a weights file holds them, float32."""
    return {
        f"{layer}.{name}": values.float().cpu()
        for layer, new in statistics.items()
        for name, values in (("running_mean", new.mean), ("running_var", new.variance))
    }


def _moved(layer: str, old: Statistics, new: Statistics, eps: float) -> MovedStatistics:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return MovedStatistics(layer, float(shift), math.exp(ratio))
