# SPDX-License-Identifier: MIT
"""Labels in memory: of the points of one scan, and of the scans of a drive."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from salsanext_cli.commands.stages.fuse import FUSED, fuse_results, require_fusable
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NoInputError, UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.uncertainty.error_features import error_probability, knows_error
from salsanext_cli.io.files.locks import temporary_folder
from salsanext_cli.io.weights.loading import load_network
from salsanext_cli.runs.fit.label_scan import labelled, prepared_for
from salsanext_cli.runs.fit.sensor_fit import fit_network
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.paths import ScanFile, drive_order
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.summary.scan_summary import RunSummary, ScanSummary

IN_MEMORY = ScanFile("scan", "points", Path("points"))
"""File of the points in warnings and errors."""

log = logging.getLogger(__name__)


class PointLabels(NamedTuple):
    """Labels, probabilities and error of the N points of a scan."""

    labels: TrainIds
    probabilities: Float
    error: Float | None


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
    scan = _scan(points, intensity)
    network = weights
    if not isinstance(network, Network):
        network = fit_network(load_network(weights), [scan])  # type: ignore[arg-type]
    prepared = prepared_for(network, IN_MEMORY, scan)
    network = prepared.network
    (pixels,) = network.predict([prepared.input], softmax=True)
    done, softmax = labelled(prepared, pixels, KnnParameters()), cast(Float, pixels.softmax)
    RunSummary(network.sensor).add(ScanSummary.of_scan(done, network.space))
    none = np.eye(1, network.space.class_count)
    of_points = points_from_pixels(softmax, done.image.pixel_of_point, none)
    error = None
    if knows_error(network):
        error = error_probability(network, done.image, softmax, done.labels)
    return PointLabels(done.labels, of_points, error)


def _scan(points: npt.ArrayLike, intensity: npt.ArrayLike | None) -> Scan:
    """Return the scan of checked arrays; its intensity is 0 if there is none."""
    try:
        coordinates = np.asarray(points)
    except ValueError:
        coordinates = np.array("lists of different lengths")
    if coordinates.ndim != 2 or coordinates.shape[1] != 3 or coordinates.dtype.kind not in "fiu":
        problem = f"an array {coordinates.shape} of {coordinates.dtype}"
        hint = "pass x, y, z and intensity separately: label(array[:, :3], array[:, 3])"
        raise UsageError("points", problem, "numbers (N, 3), in metres", hint)
    values = np.zeros(len(coordinates)) if intensity is None else np.asarray(intensity)
    if values.shape != coordinates.shape[:1] or values.dtype.kind not in "fiu":
        problem = f"an array {values.shape} of {values.dtype}"
        raise UsageError("intensity", problem, f"numbers ({len(coordinates)},), one per point")
    # Numbers outside the range of float32 become infinite: no measurement.
    with np.errstate(over="ignore", invalid="ignore"):
        return Scan(coordinates.astype(np.float32), values.astype(np.float32))


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
