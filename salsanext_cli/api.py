# SPDX-License-Identifier: MIT
"""Labels in memory: of the points of one scan, and of the scans of a drive."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy.typing as npt

from salsanext_cli.commands.stages.fuse import require_fusable
from salsanext_cli.core.api import (
    PointLabels,
    around_sensor,
    fitted_to_scan,
    point_labels,
    scan_of_arrays,
)
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.fuse_drive import fuse_drive
from salsanext_cli.core.fusion.window import warn_without_movable_classes
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.texts import with_hint
from salsanext_cli.drive_labels import DriveLabels, label_in_memory
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.weights.loading import load_network
from salsanext_cli.runs.drives.by_sequence import by_sequence
from salsanext_cli.runs.drives.scans_of_drive import computed_drive, drive_findings, drive_of_scans
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.selection import scans_of

log = logging.getLogger(__name__)


def label(
    points: npt.ArrayLike,
    intensity: npt.ArrayLike | None = None,
    weights: Path | str | Network | None = None,
    origin: npt.ArrayLike | None = None,
) -> PointLabels:
    """Label the points of one scan as `predict` does: fit the sensor, check, predict, refine.

    Warnings about the scan are logged by the logger ``salsanext_cli``.

    Parameters
    ----------
    points : (N, 3) numbers
        x, y, z in metres, around the sensor unless there is an `origin`. Points that are NaN,
        infinite or zero get label 0.
    intensity : (N,) numbers, optional
        Intensity on any scale.
    weights : Path, str or Network, optional
        Weights file, which is loaded and fitted to these points; by default that of the package. A
        network is used without fitting, which is faster for many scans: see `fit_network`.
    origin : (3,) numbers, optional
        Position of the sensor in the frame of the points, such as that of a map, in metres. No
        poses are read here: without it, a network that is fitted to scans of a map takes the
        position that the points show.

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
    scan = scan_of_arrays(points, intensity, origin)
    if isinstance(weights, Network):
        return point_labels(scan, weights if origin is None else around_sensor(weights))
    return point_labels(scan, fitted_to_scan(load_network(weights, precision="auto"), scan))


class FusedScan(NamedTuple):
    """Scan that `label_drive` has labelled."""

    name: str
    scan: Scan
    labels: TrainIds
    disagreement: Float


def label_drive(folder: Path | str, weights: Path | str | None = None) -> Iterator[FusedScan]:
    """Label the scans of a drive, and fuse the labels of scans that see the same location.

    Labels and votes of all scans are kept in memory, about 1 MB for 120 000 points. The first scan
    is yielded after all are labelled. Failed scans are logged as errors and skipped.

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
    options = RunOptions()
    require_fusable(source, Path(), options)
    path = None if weights is None else Path(weights)
    settings = NetworkSettings(weights=path, precision="auto")
    labelled = label_in_memory(source, scans_of(source), settings)
    space = labelled.network.space
    warn_without_movable_classes(space)
    drives = by_sequence(labelled.scans, partial(_drive_of, labelled))
    for name, drive in drives.items():
        if isinstance(drive, Drive):
            for finding in drive_findings(labelled.files(name), drive):
                log.warning("%s", finding.about(f"sequence {name}"))
        else:
            log.error("%s", with_hint(drive.headline, drive.hint))
    for name, drive in drives.items():
        if isinstance(drive, Drive):
            yield from _fused_scans(labelled, name, drive)


def _drive_of(labelled: DriveLabels, sequence: str) -> Drive:
    """Return the drive of a sequence, computed without poses of its scans."""
    files = labelled.files(sequence)
    drive = drive_of_scans(files, labelled.sensor, labelled.origin_of)
    return drive or computed_drive(files, labelled.sensor, labelled.origin_of)


def _fused_scans(labelled: DriveLabels, sequence: str, drive: Drive) -> Iterator[FusedScan]:
    """Yield the scans of a sequence with fused labels; log the errors of the others."""
    fused = fuse_drive(labelled.voting_scans(sequence), drive, labelled.network.space)
    for file, result in zip(labelled.files(sequence), fused, strict=True):
        if isinstance(result, SalsanextError):
            log.error("%s", with_hint(result.headline, result.hint))
            continue
        scan = read_scan(file.path, labelled.sensor)
        yield FusedScan(file.name, scan, result.labels, result.disagreement)
