# SPDX-License-Identifier: MIT
"""Batch-norm statistics re-estimated on scans without labels."""

import logging
import math
from dataclasses import replace
from typing import Any

from salsanext_cli.errors import FormatError, UsageError, counted
from salsanext_cli.fitting import batch_norm
from salsanext_cli.fitting.label_scan import project_for
from salsanext_cli.fitting.scan_fit import ADAPTED_SHARE, EGO
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.training.tuning.scans import Tuned, TuningScans

log = logging.getLogger(__name__)


def fit_batchnorm(scans: TuningScans, share: float = ADAPTED_SHARE) -> Tuned:
    """Move the statistics of batch norm towards those of scans of one's own.

    Reports of every batch norm, in order of computation, means over its channels: `shift`, of the
    mean in old standard deviations, and `variance_ratio`, new to old, ε added to both (geometric).
    """
    if not 0 < share <= 1:
        raise UsageError("--share", f"{share:g}", "above 0, at most 1")
    batch_norm.require_norms(scans.loaded)
    network = scans.network
    layers = batch_norm.norms(network.module)
    old = {name: batch_norm.Statistics.kept_by(layer) for name, layer in layers.items()}
    pooled, summary = batch_norm.PooledStatistics(network, share), RunSummary(network.sensor)
    for file in scans.each():
        projected = project_for(network, file)
        image = projected.image
        summary.add(ScanSummary(file, projected.check))
        if not (image.pixel_of_point >= 0).any():
            none = f"none of its {len(image.pixel_of_point)} points has a pixel"
            raise FormatError(file.path, none, "points that were measured, in view of the sensor")
        pooled.add(image.channels, file.path)
        log.info("%s: done", file.name)
    new, sensor, trained = pooled.moved(), network.sensor, network.card.sensor
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
    return Tuned(card, report, batch_norm.as_tensors(new))


def _moved(
    layer: str, old: batch_norm.Statistics, new: batch_norm.Statistics, eps: float
) -> dict[str, Any]:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return {"layer": layer, "shift": float(shift), "variance_ratio": math.exp(ratio)}
