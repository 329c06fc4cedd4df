# SPDX-License-Identifier: MIT
"""Files that labelling tools have written: the scans that they belong to, and their labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.errors import LabelError, NoInputError, counted, first_few
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats import format_of, suffixes_in_words
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.label_scalars import (
    LABEL_READER,
    LabelIds,
    LabelledCloud,
    read_labelled_cloud,
    whole_numbers,
)
from salsanext_cli.formats.npy import read_integers
from salsanext_cli.geometry.label_transfer import (
    TOLERANCE_M,
    LabelTransfer,
    merged_transfers,
    transfer_labels,
)
from salsanext_cli.labelling.label_records import ImportedScan
from salsanext_cli.records import Float
from salsanext_cli.results.paths import ScanFile, counted_by_suffix

LABEL_SUFFIXES = (".label", ".npy")  # Of files of labels alone, one for each point
MAX_UNMATCHED = 0.01  # Largest share of the points of a cloud that are none of the scan's
ROUNDED_M = 0.05  # Nearer coordinates were probably rounded; other scans are farther away


def find_edited(source: Path) -> list[Path]:
    """Return a file with labels, or those in a folder and below it that are not hidden, sorted."""
    expected = f"labels: {suffixes_in_words(LABEL_READER)}, {', '.join(LABEL_SUFFIXES)} files"
    if not present(source):
        raise NoInputError(source, "no such file or folder", expected)
    if not is_folder(source):
        if not _is_edited(source):
            found = f"a {source.suffix} file" if source.suffix else "has no suffix"
            raise NoInputError(source, found, expected, "save it as .ply, in CloudCompare too")
        return [source.absolute()]
    top = source.absolute()
    below = (path for path in top.rglob("*") if not path.is_dir())
    files = sorted(p for p in below if not any(n[0] == "." for n in p.relative_to(top).parts))
    edited = [path for path in files if _is_edited(path)]
    if not edited:
        others = f", but {counted_by_suffix(files)}" if files else ""
        raise NoInputError(source, f"holds no labels{others}", expected)
    return edited


def _is_edited(path: Path) -> bool:
    return path.suffix.lower() in LABEL_SUFFIXES or _has_points(path)


def _has_points(path: Path) -> bool:
    form = format_of(path.name)
    return form is not None and form.label_columns is not None


def scan_of_edited(path: Path, source: Path, scans: Sequence[ScanFile]) -> ScanFile:
    """Return the scan of an edited file: the only one, or that of its stem or of a word in it.

    `source`: the file or folder that was named. If a folder above or a word of the name tells the
    sequence, only its scans count.
    """
    if not is_folder(source) and len(scans) == 1:
        return scans[0]
    sequence = _sequence_of(path, source, {scan.sequence for scan in scans})
    within = [scan for scan in scans if sequence in (None, scan.sequence)]
    words = _words(path.stem)
    fitting = [scan for scan in within if scan.stem == path.stem]
    fitting = fitting or [scan for scan in within if scan.stem in words]
    if len(fitting) > 1:
        fitting = [scan for scan in fitting if scan.sequence in words] or fitting
    if len(fitting) == 1:
        return fitting[0]
    where = "" if sequence is None else f" in sequence {sequence}"
    found, hint = f"belongs to no scan{where}", "rename it"
    if fitting:
        found = f"may belong to {first_few([scan.name for scan in fitting])}"
        hint = "put it into a folder with the name of its sequence"
    expected = "the name of one scan, alone or as a word, as in `000010 - Cloud.ply`"
    raise LabelError(path, found, expected, hint)


def _sequence_of(path: Path, source: Path, sequences: set[str]) -> str | None:
    """Return the sequence that a folder above a file names, None if none does."""
    top = source.absolute()
    for folder in path.parents:
        if folder.parent.name == "sequences":
            return folder.name
        if folder.name in sequences and (folder == top or top in folder.parents):
            return folder.name
    return None


def _words(text: str) -> set[str]:
    """Return every part of a name that no letter or digit touches."""
    borders = range(len(text) + 1)
    starts = [i for i in borders if not text[:i][-1:].isalnum()]
    ends = [i for i in borders if not text[i:][:1].isalnum()]
    return {text[start:end] for start in starts for end in ends if start < end}


def read_file_labels(
    path: Path, points: Float, meanings: LabelIds, scalar: str | None = None
) -> tuple[LabelTransfer, str]:
    """Read the labels of points (N, 3), matched by place or order, and the name of their scalar."""
    has_points = _has_points(path)
    cloud = read_labelled_cloud(path, scalar) if has_points else _of_all_points(path, points)
    if unknown := meanings.unknown(cloud.ids):
        listed = ", ".join(f"{i} ({counted(n, 'point')})" for i, n in sorted(unknown.items()))
        hint = "map a tool's own ids with --map"
        raise LabelError(path, f"unknown label ids {listed}", meanings.described(), hint)
    raw, every = meanings.to_raw(cloud.ids), np.ones(len(points), bool)
    if has_points:
        transfer = transfer_labels(points, cloud.points, raw)
        _require_same_scan(path, transfer)
    else:
        transfer = LabelTransfer(raw, every, ~every, every, np.empty(0), len(points))
    return transfer, cloud.scalar


def edited_labels(
    scan: ScanFile,
    parts: Mapping[Path, tuple[LabelTransfer, str]],
    space: LabelSpace,
    unlabelled: int,
) -> tuple[RawIds, ImportedScan]:
    """Return the raw ids (N,) uint32 that files hold of a scan, with instances, and numbers of it.

    `unlabelled`: raw id of the points without a label.
    """
    transfers = [transfer for transfer, _ in parts.values()]
    merged = merged_transfers(transfers, unlabelled)
    in_one_file = np.any([transfer.ambiguous for transfer in transfers], axis=0)
    scalar = ", ".join(sorted({scalar for _, scalar in parts.values()}))
    raw = merged.filled(unlabelled)
    labelled = int(space.scored[space.to_train(raw, strict=False)].sum())
    if not labelled:
        text = f"{scalar}: none of the {counted(len(raw), 'point')} has a class that counts"
        hint = "label some, or name the scalar with --scalar"
        raise LabelError(first_few([*parts]), text, "at least one", hint)
    return raw, ImportedScan(
        scan=scan.name,
        files=tuple(map(str, parts)),
        points=len(raw),
        labelled=labelled,
        unlabelled=int(merged.known.sum()) - labelled,
        ambiguous=int(merged.ambiguous.sum()),
        missing=int(merged.missing.sum()),
        unmatched=len(merged.unmatched),
        contradicted=int((merged.ambiguous & ~in_one_file).sum()),
        scalar=scalar,
    )


def _of_all_points(path: Path, points: Float) -> LabelledCloud:
    """Read a file of labels only, one for each point in order."""
    if path.suffix.lower() == ".npy":
        values: npt.NDArray[np.integer] = read_integers(path)
        if len(values) != len(points):
            found, expected = counted(len(values), "label"), f"{len(points):,}, one per point"
            raise LabelError(path, found, f"{expected} of the scan", "use those of this scan")
    else:
        values = read_labels(path, len(points))
    return LabelledCloud(points, whole_numbers(values, path, "label"), "labels")


def _require_same_scan(path: Path, transfer: LabelTransfer) -> None:
    """Refuse a cloud of which too many points are none of the scan's."""
    count = len(transfer.unmatched)
    if count <= MAX_UNMATCHED * transfer.cloud_points:
        return
    distance = float(np.median(transfer.unmatched))
    cause = "it is of another scan, or its coordinates were shifted, turned or scaled"
    if distance < ROUNDED_M:
        cause = "its coordinates were rounded or moved: save it with more digits"
    found = f"{count:,} of its {transfer.cloud_points:,} points are none of the scan's"
    found += f", but {distance:.3g} m from the nearest (median)"
    raise LabelError(path, found, f"all within {1000 * TOLERANCE_M:g} mm of one", cause)
