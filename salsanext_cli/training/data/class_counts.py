# SPDX-License-Identifier: MIT
"""Class counts: points of every class in labelled scans, checked on the way; class weights."""

import hashlib
import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.network.card import scan_digest, split_digests
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.plain_data import MALFORMED, decoded
from salsanext_cli.core.records import Double, Mask
from salsanext_cli.core.texts import counted
from salsanext_cli.io.files.json_files import encode_json, read_json
from salsanext_cli.io.files.reading import identity
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, log_recorded
from salsanext_cli.training.data.reading_progress import with_progress
from salsanext_cli.training.data.sources import Source, read_labelled, without_vehicle

Counts = npt.NDArray[np.int64]
RARE_SHARE = 0.01  # Share of scored training points below which a class is rare
COUNTED_POINTS = "without those of the vehicle"  # Counts of version 0.9 are counted again

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClassCounts:
    """Result of reading labelled scans once."""

    points: Counts  # (C,): training points of each class
    warnings: list[ScanWarning]  # About scans of either split
    digests: dict[ScanFile, str]  # Of the training scans


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CountedScan:
    """Labelled scan that was read once."""

    points: Counts  # (C,): number of points of each class
    summary: ScanSummary  # Result of the checks
    digest: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CountedScans:
    """F labelled scans that were read once."""

    points: Counts  # (F, C) int64: number of points of each class
    summaries: list[ScanSummary]  # Results of the checks
    digests: list[str]


def count_classes(source: Source, jobs: int = 1) -> CountedScans:
    """Read the scans of a source, check them and count the classes of the points of training."""
    # Without fitted sensors, the network learns from unchanged intensities.
    plain = replace(source.sensor, intensity_quantiles=())

    def count(file: ScanFile) -> CountedScan:
        seen = source.sensor_of(file) if source.fitted else plain
        trained = source.sensor if source.fitted else plain
        annotated = read_labelled(file, source.space, seen)
        scan = annotated.scan
        check = check_scan(file.path, scan, sensor_of(scan, seen), trained)
        trained_labels = without_vehicle(annotated, seen).labels
        return CountedScan(
            points=np.bincount(trained_labels, minlength=source.space.class_count),
            summary=ScanSummary(file=file, check=check),
            digest=scan_digest(scan),
        )

    # Threads suffice, since reading and counting release the interpreter's lock.
    run = joblib.Parallel(jobs, backend="threading", return_as="generator")
    calls = [joblib.delayed(count)(file) for file in source.files]
    scans = list(with_progress(run(calls), len(source.files)))
    points = np.array([scan.points for scan in scans], np.int64)
    return CountedScans(
        points=points.reshape(-1, source.space.class_count),
        summaries=[scan.summary for scan in scans],
        digests=[scan.digest for scan in scans],
    )


def class_shares(counts: Counts, scored: Mask) -> Double:
    """Return the share of each class in the scored points, (C,) float64; 0 for ignored classes."""
    used = np.where(scored, counts, 0).astype(np.float64)
    return used / max(used.sum(), 1)


def class_weights(counts: Counts, scored: Mask, exponent: float = 0.5) -> Tensor:
    """Return share**-exponent of each class, (C,) float32; 0 for ignored and absent classes."""
    share = class_shares(counts, scored)
    weights = np.divide(1, share**exponent, out=np.zeros_like(share), where=share > 0)
    return torch.from_numpy(weights.astype(np.float32))


def rare_classes(counts: Counts, scored: Mask) -> Mask:
    """Return which scored classes are rare, (C,) bool."""
    return scored & (class_shares(counts, scored) < RARE_SHARE)


def class_counts(
    path: Path,
    sources: Sequence[Source],
    validation: Source,
    validated: Sequence[ScanFile],
    jobs: int = 1,
    also: float = 0.0,
) -> ClassCounts:
    """Count the points per class of all training data; check all scans.

    A JSON file caches the result until a file changes, since SemanticKITTI has 55 GB. Points count
    as often as they are drawn: further sources get the share `also` of the samples.
    """
    first, *further = sources
    names = first.space.names
    digest = data_digest([*sources, validation], validated, also if further else 0.0)
    files = [file for source in sources for file in source.files]
    cached = _cached(path, digest, files, names)
    if cached:
        log_recorded(cached.warnings)
        return cached
    total = counted(len(files) + len(validation.files), "scan")
    log.log(NOTICE, "reading %s, to check them and to count their classes", total)
    counted_validation = count_classes(validation, jobs)
    counted_training = count_classes(first, jobs)
    members = set(validated)
    is_validated = [file in members for file in validation.files]
    require_scored(first.space, validated, counted_validation.points[is_validated])
    require_scored(first.space, first.files, counted_training.points)
    warnings = _warnings(first, [*counted_training.summaries, *counted_validation.summaries])
    digests = list(counted_training.digests)
    points = counted_training.points.sum(axis=0)
    if further:
        per_draw = (1 - also) * counted_training.points.mean(axis=0)
        for source in further:
            scans = count_classes(source, jobs)
            digests += scans.digests
            per_draw += also / len(further) * scans.points.mean(axis=0)
            if not source.simulated:
                warnings += _warnings(source, scans.summaries)
        points = np.rint(len(first.files) * per_draw).astype(np.int64)
    content = {
        "files": digest,
        "points": dict(zip(names, points.tolist(), strict=True)),
        "warnings": warnings,
        "scans": "".join(digests),
    }
    OwnedFolder(path.parent).write(path, encode_json(content))
    return ClassCounts(
        points=points, warnings=warnings, digests=dict(zip(files, digests, strict=True))
    )


def require_scored(space: LabelSpace, scans: Sequence[ScanFile], counts: Counts) -> None:
    """Refuse scans without a point of a scored class; `counts` (F, C) are theirs."""
    points = counts.sum(axis=0)
    if not scans or points[space.scored].any():
        return
    total = f"{counted(points.sum(), 'point')} in {counted(len(scans), 'scan')}"
    problem = f"none of {total} is of a scored class"
    raise TrainingError(scans[0].label_path.parent, problem, f"labels of {space.name}")


def _warnings(source: Source, summaries: Sequence[ScanSummary]) -> list[ScanWarning]:
    """Return the warnings about scans; each fitted sequence may have another sensor."""
    summary = RunSummary(sensor=source.sensor)
    for _, members in groupby(summaries, lambda scan: source.fitted and scan.file.sequence):
        for scan in members:
            summary.add(scan)
        summary.compare_scans()
    return summary.finished().warnings()


def _cached(
    path: Path, digest: str, files: Sequence[ScanFile], names: Sequence[str]
) -> ClassCounts | None:
    """Read cached counts; None if they are of other data, or damaged."""
    recorded = read_json(path) or {}
    if recorded.get("files") != digest:
        return None
    try:
        return ClassCounts(
            points=np.array([recorded["points"][name] for name in names], np.int64),
            warnings=decoded(list[ScanWarning], recorded["warnings"]),
            digests=dict(zip(files, split_digests(recorded["scans"]), strict=True)),
        )
    except (*MALFORMED, LookupError, OverflowError):
        return None


def data_digest(sources: Sequence[Source], validated: Sequence[ScanFile], also: float) -> str:
    """Return a digest of all that class counts depend on, such as sizes and times of files."""
    settings: list[Any] = [COUNTED_POINTS, also]
    for source in sources:
        sensors = [source.sensor, *source.fitted.values()]
        settings += [source.space.to_dict(), *(sensor.to_dict() for sensor in sensors)]
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    files = [*(file for source in sources for file in source.files), *validated]
    for file in files:
        for path in (file.path, file.label_path):
            # Without the folder, since a data set may move
            _, _, *state = identity(path) or (None, None)
            digest.update(f"{state}\n".encode())
    return digest.hexdigest()[:16]
