# SPDX-License-Identifier: MIT
"""Labels in memory: from the points of one scan to their labels."""

import logging
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.label_checks import label_findings
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fitting.network_fit import FitSettings, fit_to_sample
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.geometry.sensor_frame import around
from salsanext_cli.core.labellers import label_scan
from salsanext_cli.core.labelling import LabelledScan, LabelRequest
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN
from salsanext_cli.core.uncertainty.error_features import knows_error

SOURCE = "points"  # Name of the scan in errors and warnings

log = logging.getLogger(__name__)


class PointLabels(NamedTuple):
    """Labels, probabilities and error of the N points of a scan."""

    labels: TrainIds
    probabilities: Float
    error: Float | None


def scan_of_arrays(
    points: npt.ArrayLike,
    intensity: npt.ArrayLike | None = None,
    origin: npt.ArrayLike | None = None,
) -> Scan:
    """Return the scan of checked arrays.

    Parameters
    ----------
    points : (N, 3) numbers
        x, y, z in metres around the sensor.
    intensity : (N,) numbers, optional
        Intensity on any scale; 0 without any.
    origin : (3,) numbers, optional
        Position of the sensor in metres, if the points are around another origin.

    Returns
    -------
    Scan
        Points around the sensor.

    Raises
    ------
    UsageError
        If the arrays have other shapes or no numbers.
    """
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
    if origin is not None:
        position = np.asarray(origin)
        _require_position(position)
        coordinates = around(coordinates, position)
    # Numbers outside the range of float32 become infinite: no measurement.
    with np.errstate(over="ignore", invalid="ignore"):
        return Scan(coordinates.astype(np.float32), values.astype(np.float32))


def _require_position(origin: npt.NDArray[Any]) -> None:
    """Refuse an array that is no position."""
    is_position = origin.shape == (3,) and origin.dtype.kind in "fiu"
    if not (is_position and np.isfinite(origin).all()):
        problem = f"is {origin.tolist()}"
        raise UsageError("origin", problem, "three numbers: the position of the sensor, in metres")


def around_sensor(network: Network) -> Network:
    """Return a network for points around the sensor, in the place of those around its origin."""
    members = [replace(m, origin=ORIGIN, registered=False) for m in network.sensor.members]
    first, *others = members
    return network.for_sensor(replace(first, others=tuple(others)))


def fitted_to_scan(network: Network, scan: Scan) -> Network:
    """Return a network fitted to the sensor of one scan, as `predict` does."""
    return fit_to_sample(network, ScanSample.from_scans([scan]), FitSettings())


def point_labels(scan: Scan, network: Network) -> PointLabels:
    """Label the points of a scan with a fitted network, and log reasons to doubt the labels.

    Parameters
    ----------
    scan : Scan
        N points around their sensor.
    network : Network
        Network that is fitted to the sensor of the scan.

    Returns
    -------
    PointLabels

    Raises
    ------
    SalsanextError
        If the points are not those of a scan in metres, or a probability is not finite.
    """
    request = LabelRequest(softmax=True, error=knows_error(network))
    labelled = label_scan(scan, network, request, source=SOURCE)
    _log_findings(labelled, network)
    return PointLabels(labelled.labels, cast(Float, labelled.softmax), labelled.error)


def _log_findings(labelled: LabelledScan, network: Network) -> None:
    """Log the first reason of each kind to doubt the labels of a scan."""
    points = np.bincount(labelled.labels, minlength=network.space.class_count)
    findings = [
        *labelled.checked.check.findings,
        *label_findings(points, labelled.mean_confidence, network.space),
    ]
    first_of_code: dict[str, Finding] = {}
    for finding in findings:
        first_of_code.setdefault(finding.code, finding)
    for finding in first_of_code.values():
        log.warning("%s", finding.about(SOURCE))
