# SPDX-License-Identifier: MIT
"""Labels in memory: of the points of one scan, and of the scans of a drive."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.commands.stages.fuse import FUSED, fuse_results, require_fusable
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.api import PointLabels, fitted_to_scan, point_labels, scan_of_arrays
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.io.files.locks import temporary_folder
from salsanext_cli.io.weights.loading import load_network
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.paths import drive_order
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_selection import ScanSelection

log = logging.getLogger(__name__)


def label(
    points: npt.ArrayLike,
    intensity: npt.ArrayLike | None = None,
    weights: Path | str | Network | None = None,
) -> PointLabels:
    """Label the points of one scan as `predict` does: fit the sensor, check, predict, refine.

    Warnings about the scan are logged by the logger ``salsanext_cli``.

    Parameters
    ----------
    points : (N, 3) numbers
        x, y, z in metres around the sensor. Points that are NaN, infinite or zero get label 0.
    intensity : (N,) numbers, optional
        Intensity on any scale.
    weights : Path, str or Network, optional
        Weights file, which is loaded and fitted to these points; by default that of the package. A
        network is used without fitting, which is faster for many scans: see `fit_network`.

    Returns
    -------
    labels : (N,) uint8
        Train ids of the label space of the weights; ``sn.label_space()`` for the default weights.
    probabilities : (N, C) float32
        Softmax of the pixel of each point, class 0 without a pixel. The kNN refinement changes
        `labels` only.
    error : (N,) float32 or None
        Probability that each label is wrong, NaN without a pixel; None without an error model in
        the weights.

    Raises
    ------
    SalsanextError
        If the arrays are not points around a sensor, or the weights cannot be used.
    """
    scan = scan_of_arrays(points, intensity)
    if isinstance(weights, Network):
        return point_labels(scan, weights)
    return point_labels(scan, fitted_to_scan(load_network(weights), scan))


class FusedScan(NamedTuple):
    """Scan that `label_drive` has labelled."""

    name: str
    scan: Scan
    labels: TrainIds
    disagreement: Float


def label_drive(folder: Path | str, weights: Path | str | None = None) -> Iterator[FusedScan]:
    """Label the scans of a drive, and fuse the labels of scans that see the same location.

    This runs `predict --fuse` in a temporary folder, so the first scan is yielded after all are
    labelled. Failed scans are logged as errors and skipped.

    Parameters
    ----------
    folder : Path or str
        Scans, and their `poses.txt`. Without it poses are computed, which needs
        ``salsanext[fuse]``.
    weights : Path or str, optional
        Weights file, which is fitted to the scans; by default that of the package.

    Yields
    ------
    FusedScan
        `name`, such as ``08/000000``; `scan` of N points; `labels` (N,) uint8, train ids as of
        `label`; `disagreement` (N,) float32, share of the votes against the label, NaN without any.
    """
    source = Path(folder)
    settings = NetworkSettings(weights=None if weights is None else Path(weights))
    with temporary_folder() as out:
        fused = ResultFolder(out / FUSED)
        require_fusable(source, out, RunOptions())
        outcome = predict_scans(source, out, settings=settings, extras=("votes",))
        for failure in outcome.failures:
            log.error("%s", failure.text)
        if not outcome.done:
            raise NoInputError(source, "no scan could be labelled", hint="see the errors above")
        for text in dict.fromkeys(failure.text for failure in fuse_results(out).failures):
            log.error("%s", text)
        files, space = fused.predicted(ScanSelection())
        for file in sorted(fused.with_column("label", files), key=drive_order):
            results = fused.read(file, fused.sensor())
            labels = space.to_train(np.asarray(results.label))
            yield FusedScan(file.name, results.scan, labels, results.uncertainty["disagreement"])
