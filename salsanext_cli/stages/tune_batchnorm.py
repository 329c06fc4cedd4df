# SPDX-License-Identifier: MIT
"""Stage `tune batchnorm`: batch-norm statistics re-estimated on scans without labels."""

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import FormatError, UsageError, counted
from salsanext_cli.files.atomic import require_target
from salsanext_cli.fitting.adaptation import SHARE
from salsanext_cli.fitting.batch_norm import (
    PooledStatistics,
    Statistics,
    as_tensors,
    require_norms,
)
from salsanext_cli.fitting.label_scan import project_for
from salsanext_cli.fitting.scan_fit import EGO, fitted
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.selection import ScanSelection, select_evenly

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
    scans are pooled in float64.

    `source`: a scan, a folder of scans, a sequence or a data set; `target`: the `.safetensors` file
    to write: all other tensors bit for bit. Its sensor is that of `network`; `scores`, measured
    with the old statistics, are left out; `share`: of the new statistics, above 0 and at most 1;
    the rest are the old ones; `network`, `selection`, `overwrite`, `progress`: as for
    `tune_temperature`.

    Returns plain data: the number of `scans`, the `share`, the name of the `sensor` of the weights
    written, and `layers`, every batch norm in order of computation: its name, `layer`; the distance
    of the new mean from the old one in old standard deviations, `shift`, mean over the channels;
    the new variance over the old, ε added to both, `variance_ratio`, geometric mean; and
    `warnings`, reasons to doubt the scans.
    """
    if not 0 < share <= 1:
        raise UsageError("--share", f"{share:g}", "above 0, at most 1")
    loaded = network.load()
    layers = require_norms(loaded)
    scans = select_evenly(source, selection, loaded.card.space)
    require_target(target, overwrite)
    loaded = fitted(network, loaded, find_scans(source))
    network.announce(loaded)
    old = {name: Statistics.kept_by(layer) for name, layer in layers.items()}
    pooled = PooledStatistics(loaded, share)
    summary = RunSummary(loaded.sensor)
    for number, file in enumerate(scans, start=1):
        projected = project_for(loaded, file)
        image = projected.image
        summary.add(ScanSummary(file, projected.check))
        if not (image.pixel_of_point >= 0).any():
            none = f"none of its {len(image.pixel_of_point)} points has a pixel"
            raise FormatError(file.path, none, "points that were measured, in view of the sensor")
        pooled.add(image.channels, file.path)
        log.info("%s/%s: done", file.sequence, file.stem)
        if progress:
            progress(number, len(scans))
    new, sensor = pooled.moved(), loaded.sensor
    scanned = counted(len(scans), "scan")
    done = f"Batch norm re-estimated on {scanned} of {sensor.name}, share {share:g}."
    # Later scans are matched and filled as these were.
    trained = loaded.card.sensor
    known = trained.intensity_quantiles if sensor.intensity_quantiles else ()
    sensor = replace(sensor, intensity_quantiles=known, row_gaps=trained.row_gaps)
    # The mounting is that of these scans, not of those that the weights will be used for.
    own = {name: getattr(trained, name) for name in ("up", "origin", *EGO)}
    sensor = replace(sensor, **own)
    card = replace(loaded.card.changed(done), sensor=sensor)
    save_with_card(network.path, target, card, as_tensors(new))
    moved = [_moved(name, old[name], new[name], layers[name].eps) for name in new]
    return {
        "stage": "tune batchnorm",
        "scans": len(scans),
        "share": share,
        "sensor": sensor.name,
        "layers": moved,
        "warnings": summary.finished().warnings(),
    }


def _moved(layer: str, old: Statistics, new: Statistics, eps: float) -> dict[str, Any]:
    variance = old.variance + eps
    shift = ((new.mean - old.mean).abs() / variance.sqrt()).mean()
    ratio = ((new.variance + eps) / variance).log().mean()
    return {"layer": layer, "shift": float(shift), "variance_ratio": math.exp(ratio)}
