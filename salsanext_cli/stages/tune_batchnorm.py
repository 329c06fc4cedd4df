# SPDX-License-Identifier: MIT
"""Stage `tune batchnorm`: batch-norm statistics re-estimated on scans without labels."""

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from salsanext_cli.errors import FormatError, UsageError, WeightsError, counted
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.coverage import CoverageCheck, field_of_view_coverage
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.scan_fit import fitted
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.storage.atomic import require_target
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.selection import ScanSelection, select_evenly
from salsanext_cli.training.tuning.batch_norm import Statistics, norms, statistics_of_scan

SHARE = 0.5
"""Share of the new statistics: within 0.3 points of the best on three sensors (docs/tune.md)."""

log = logging.getLogger(__name__)


def tune_batchnorm(
    source: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    share: float = SHARE,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
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
    share : float
        Of the new statistics, above 0 and at most 1; the rest are the old ones.
    network, selection, overwrite, progress
        As for `tune_temperature`.

    Returns
    -------
    dict
        JSON-able: the number of `scans`, the `share`, the name of the `sensor` of the weights
        written, and `layers`, every batch norm in order of computation: its name, `layer`; the
        distance of the new mean from the old one in old standard deviations, `shift`, mean over the
        channels; the new variance over the old, ε added to both, `variance_ratio`, geometric mean.

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
    loaded = fitted(network, loaded, find_scans(source))
    network.announce(loaded)
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
    scanned = counted(len(scans), "scan")
    done = f"Batch norm re-estimated on {scanned} of {sensor.name}, share {share:g}."
    description = f"{loaded.card.description} {done}".lstrip()
    # On the scale that the intensity of later scans is matched to.
    known = loaded.card.sensor.intensity_quantiles if sensor.intensity_quantiles else ()
    sensor = replace(sensor, intensity_quantiles=known)
    card = replace(loaded.card, sensor=sensor, scores={}, description=description)
    save_with_card(network.path, target, card, _tensors(new))
    moved = [_moved(name, old[name], new[name], layers[name].eps) for name in new]
    return {
        "stage": "tune batchnorm",
        "scans": len(scans),
        "share": share,
        "sensor": sensor.name,
        "layers": moved,
    }


def _statistics(
    file: ScanFile, network: Network, share: float, check: CoverageCheck
) -> Mapping[str, Statistics]:
    """Read and project a scan; return its statistics, by layer."""
    scan = read_scan(file.path, network.sensor)
    image = project(scan, network.sensor, network.device)
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


def _moved(layer: str, old: Statistics, new: Statistics, eps: float) -> dict[str, Any]:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return {"layer": layer, "shift": float(shift), "variance_ratio": math.exp(ratio)}
