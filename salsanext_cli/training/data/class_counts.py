# SPDX-License-Identifier: MIT
"""Class counts: points of every class in labelled scans, checked on the way; class weights."""

import hashlib
import json
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

from salsanext_cli.errors import LabelError, TrainingError, counted
from salsanext_cli.files.identity import identity
from salsanext_cli.files.json_files import MALFORMED, decoded, encode_json, read_json
from salsanext_cli.fitting.label_scan import check_with_hint
from salsanext_cli.labelling.label_records import require_truth
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary, ScanWarning, log_recorded
from salsanext_cli.network.card import parted, scan_digest
from salsanext_cli.records import Double, Mask
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.training.data.sources import Source, read_labelled

Counts = npt.NDArray[np.int64]
RARE_SHARE = 0.01  # Share of the scored training points below which a class is rare


@dataclass(frozen=True, slots=True, eq=False)
class ClassCounts:
    """Result of reading labelled scans once."""

    points: Counts  # (C,): training points of each class
    warnings: list[ScanWarning]  # About scans of either split
    digests: dict[ScanFile, str]  # Of the training scans


def require_labels(files: Sequence[ScanFile]) -> None:
    """Raise `LabelError` naming the first scan without a label file, or with a first guess."""
    missing = [file for file in files if not file.label_path.is_file()]
    if missing:
        others = f", nor for {counted(len(missing) - 1, 'other scan')}" if len(missing) > 1 else ""
        found, expected = f"no such file{others}", "a label file for every scan of the split"
        raise LabelError(missing[0].label_path, found, expected)
    require_truth(files)


def count_classes(source: Source, jobs: int = 1) -> tuple[Counts, list[ScanSummary], list[str]]:
    """Return counts (F, C) int64, what checks found, and a digest of each of F scans."""
    # Unless it is fitted, the network learns from the intensity as it is.
    plain = replace(source.sensor, intensity_quantiles=())

    def count(file: ScanFile) -> tuple[Counts, ScanSummary, str]:
        own, trained = plain, plain
        if source.fitted:
            own, trained = source.sensor_of(file), source.sensor
        scan, labels = read_labelled(file, source.space, own)
        check = check_with_hint(file.path, scan, own, trained)
        counts = np.bincount(labels, minlength=source.space.class_count).astype(np.int64)
        return counts, ScanSummary(file, check), scan_digest(scan)

    # Reading and counting release the interpreter's lock, so that threads do.
    run = joblib.Parallel(jobs, backend="threading")
    results = run(joblib.delayed(count)(f) for f in source.files)
    counts = np.reshape([counts for counts, _, _ in results], (-1, source.space.class_count))
    return counts.astype(np.int64), [each[1] for each in results], [each[2] for each in results]


def class_shares(counts: Counts, scored: Mask) -> Double:
    """Return the share of every class in the scored points, (C,) float64; 0 for ignored ones."""
    used = np.where(scored, counts, 0).astype(np.float64)
    return used / max(used.sum(), 1)


def class_weights(counts: Counts, scored: Mask, exponent: float = 0.5) -> Tensor:
    """Return share**-exponent of every class, (C,) float32; 0 for those ignored or never seen."""
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
    """Return the points per class of all training data, reading and checking all scans."""
    # The JSON file keeps the result until a file changes: a whole SemanticKITTI is 55 GB. Points
    # count as often as they are drawn: further sources get the share `also` of the samples.
    first, *further = sources
    space, training = first.space, first.files
    digest = data_digest([*sources, validation], validated, also if further else 0.0)
    files = [file for source in sources for file in source.files]
    if kept := _kept(path, digest, files, space.names):
        log_recorded(kept.warnings)
        return kept
    of_validation, summaries, _ = count_classes(validation, jobs)
    scored = {*validated}
    of_validated = of_validation[[file in scored for file in validation.files]].sum(axis=0)
    of_training, others, digests = count_classes(first, jobs)
    counts = of_training.sum(axis=0)
    for scans, of_scans in ((validated, of_validated), (training, counts)):
        if scans and not of_scans[space.scored].any():
            total = f"{counted(of_scans.sum(), 'point')} in {counted(len(scans), 'scan')}"
            found = f"none of {total} is of a class that counts"
            raise TrainingError(scans[0].label_path.parent, found, f"labels of {space.name}")
    warnings = _warnings(first, [*others, *summaries])
    if further:
        per_draw = (1 - also) * of_training.mean(axis=0)
        for source in further:
            of_source, others, own = count_classes(source, jobs)
            digests += own
            per_draw += also / len(further) * of_source.mean(axis=0)
            warnings += [] if source.simulated else _warnings(source, others)
        counts = np.rint(len(training) * per_draw).astype(np.int64)
    result = ClassCounts(counts, warnings, dict(zip(files, digests, strict=True)))
    by_name = dict(zip(space.names, counts.tolist(), strict=True))
    content = {"files": digest, "points": by_name, "warnings": warnings, "scans": "".join(digests)}
    OwnedFolder(path.parent).write(path, encode_json(content))
    return result


def _warnings(source: Source, summaries: Sequence[ScanSummary]) -> list[ScanWarning]:
    """Return the reasons to doubt scans; each fitted sequence may have a sensor of its own."""
    summary = RunSummary(source.sensor)
    for _, members in groupby(summaries, lambda each: source.fitted and each.file.sequence):
        for scan in members:
            summary.add(scan)
        summary.compare_scans()
    return summary.finished().warnings()


def _kept(
    path: Path, digest: str, files: Sequence[ScanFile], names: Sequence[str]
) -> ClassCounts | None:
    """Read counts that were kept; None if they are of other data, or damaged."""
    known = read_json(path) or {}
    if known.get("files") != digest:
        return None
    try:
        counts = np.array([known["points"][name] for name in names], np.int64)
        digests = dict(zip(files, parted(known["scans"]), strict=True))
        return ClassCounts(counts, decoded(list[ScanWarning], known["warnings"]), digests)
    except (*MALFORMED, LookupError, OverflowError):
        return None


def data_digest(
    sources: Sequence[Source], validated: Sequence[ScanFile] = (), also: float = 0.0
) -> str:
    """Return a digest of all that class counts depend on: of files, their sizes and times."""
    settings: list[Any] = [also]
    for source in sources:
        sensors = [source.sensor, *source.fitted.values()]
        settings += [source.space.to_dict(), *(sensor.to_dict() for sensor in sensors)]
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    files = [*(file for source in sources for file in source.files), *validated]
    for path in (path for file in files for path in (file.path, file.label_path)):
        # Without its folder: a data set may move.
        _, _, *state = identity(path) or (None, None)
        digest.update(f"{state}\n".encode())
    return digest.hexdigest()[:16]
