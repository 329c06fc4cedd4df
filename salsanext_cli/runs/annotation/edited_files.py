# SPDX-License-Identifier: MIT
"""Files of labelling tools: their scans and their labels."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.geometry.label_transfer import TOLERANCE_M, LabelTransfer, transfer_labels
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.core.wording import argument
from salsanext_cli.io.annotation_tools.registry import lacks_labels, tool_of
from salsanext_cli.io.annotation_tools.tool import AnnotationTool, ToolLabels
from salsanext_cli.io.files.reading import is_folder, present
from salsanext_cli.io.formats import format_of, suffixes_in_words
from salsanext_cli.io.formats.label_scalars import (
    LABEL_READER,
    LabelIds,
    LabelledCloud,
    whole_numbers,
)
from salsanext_cli.io.formats.npy import read_integers
from salsanext_cli.runs.annotation.label_records import ImportedScan
from salsanext_cli.runs.annotation.las_classification import map_of_codes, unknown_codes
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_folders import counted_by_suffix

LABEL_ARRAY = ".npy"  # Suffix of a file with one label per point and no coordinates
LABEL_SUFFIXES = (".label", LABEL_ARRAY)  # Files of labels alone, one per point
MAX_UNMATCHED = 0.01  # Largest share of the points of a cloud that are not in the scan
ROUNDED_M = 0.05  # Below it, coordinates were probably rounded; other scans are farther away

log = logging.getLogger(__name__)


def find_edited(source: Path) -> list[Path]:
    """Return a file with labels, or all in and below a folder that are not hidden, sorted."""
    suffixes = f"{suffixes_in_words(LABEL_READER)}, {', '.join(LABEL_SUFFIXES)}"
    expected = f"labels: {suffixes} files, or those of a labelling tool"
    if not present(source):
        raise NoInputError(source, "no such file or folder", expected)
    top = source.absolute()
    if not is_folder(source):
        if not _is_edited(source):
            problem = f"is a {source.suffix} file" if source.suffix else "has no suffix"
            raise NoInputError(source, problem, expected, "save it as .ply")
        return [top]
    below = (path for path in top.rglob("*") if not path.is_dir())
    files = sorted(p for p in below if not any(n[0] == "." for n in p.relative_to(top).parts))
    edited = [path for path in files if _is_edited(path) and not lacks_labels(path)]
    if not edited:
        others = f", but {counted_by_suffix(files)}" if files else ""
        raise NoInputError(source, f"contains no labels{others}", expected)
    return edited


def has_coordinates(path: Path) -> bool:
    """Return whether an edited file may have points, not only labels in the order of the scan."""
    return path.suffix.lower() not in LABEL_SUFFIXES


def _is_edited(path: Path) -> bool:
    return path.suffix.lower() == LABEL_ARRAY or _has_points(path) or tool_of(path) is not None


def _has_points(path: Path) -> bool:
    form = format_of(path.name)
    return form is not None and form.label_columns is not None


def scan_of_edited(path: Path, source: Path, scans: Sequence[ScanFile]) -> ScanFile:
    """Return the scan of an edited file: the only one, or the one named by its stem or by a word.

    `source` is the file or folder on the command line. If a folder above the file or a word of its
    name is a sequence, only scans of that sequence count. A name may have `_` in place of dots. A
    whole name comes before its words, since scans may be named `1` and `1.5`.
    """
    if not is_folder(source) and len(scans) == 1:
        return scans[0]
    sequence = _sequence_of(path, source, {scan.sequence for scan in scans})
    within = [scan for scan in scans if sequence in (None, scan.sequence)]
    fitting = [scan for scan in within if scan.stem == path.stem]
    fitting = fitting or [scan for scan in within if path.stem in _names_in_tools(scan)]
    fitting = fitting or _named_by_words(within, _words(path.stem))
    if len(fitting) == 1:
        return fitting[0]
    where = "" if sequence is None else f" in sequence {sequence}"
    problem = f"belongs to no scan{where}"
    hint = "rename it"
    if fitting:
        problem = f"may belong to {first_few([scan.name for scan in fitting])}"
        hint = "put it into a folder with the name of its sequence"
    expected = "the name of one scan, alone or as a word, as in `000010 - Cloud.ply`"
    raise LabelError(path, problem, expected, hint)


def _sequence_of(path: Path, source: Path, sequences: set[str]) -> str | None:
    """Return the sequence named by a folder above a file; None without one."""
    top = source.absolute()
    for folder in path.parents:
        if folder.parent.name == "sequences":
            return folder.name
        if folder.name in sequences and (folder == top or top in folder.parents):
            return folder.name
    return None


def _names_in_tools(scan: ScanFile) -> set[str]:
    """Return the names that tools give the files of a scan, but for the stem of the scan itself."""
    without_dots = scan.stem.replace(".", "_")
    names = {without_dots, f"{scan.sequence}_{scan.stem}", f"{scan.sequence}_{without_dots}"}
    return names - {scan.stem}


def _named_by_words(scans: Sequence[ScanFile], words: set[str]) -> list[ScanFile]:
    """Return the scans that a word names, those of a named sequence if any are."""
    fitting = [scan for scan in scans if words & {scan.stem, scan.stem.replace(".", "_")}]
    if len(fitting) == 1:
        return fitting
    return [scan for scan in fitting if scan.sequence in words] or fitting


def _words(text: str) -> set[str]:
    """Return every part of a name between characters that are not letters or digits."""
    borders = range(len(text) + 1)
    starts = [i for i in borders if not text[:i][-1:].isalnum()]
    ends = [i for i in borders if not text[i:][:1].isalnum()]
    return {text[start:end] for start in starts for end in ends if start < end}


def read_edited(
    path: Path,
    scan: ScanFile,
    cloud_of_scan: Scan,
    meanings: LabelIds,
    space: LabelSpace,
    scalar: str | None = None,
) -> tuple[RawIds, ImportedScan]:
    """Read the labels of the N points of a scan, matched by coordinates or order.

    Return raw ids with instances, (N,) uint32, unlabelled where there are none, and the numbers of
    points.
    """
    points = cloud_of_scan.points
    tool = _tool_of(path, scalar)
    labels = _labels_of(path, tool, cloud_of_scan, meanings, space, scalar)
    cloud = labels.cloud
    meanings = labels.meanings
    if unknown := meanings.unknown(cloud.ids):
        raise _unknown_ids(path, cloud, unknown, meanings, space)
    raw = meanings.to_raw(cloud.ids)
    if labels.is_in_order:
        transfer = LabelTransfer.in_order(raw)
    else:
        transfer = transfer_labels(points, cloud.points, raw)
        _require_same_scan(path, transfer)
    raw = transfer.filled(meanings.unlabelled)
    labelled = int(space.scored[space.to_train(raw, strict=False)].sum())
    if not labelled:
        problem = f"has no labelled points: the classes of all {len(raw):,} are ignored"
        hint = f"label some, or name another scalar with {argument('scalar')}"
        raise LabelError(path, problem, f"at least one in {cloud.scalar}", hint)
    return raw, ImportedScan(
        scan=scan.name,
        files=(str(path),),
        points=len(raw),
        labelled=labelled,
        unlabelled=int(transfer.has_label.sum()) - labelled,
        ambiguous=int(transfer.ambiguous.sum()),
        missing=int(transfer.missing.sum()),
        unmatched=len(transfer.unmatched),
        scalar=cloud.scalar,
        tool=tool.name if tool is not None and tool.is_sure_of(path) else "",
    )


def _tool_of(path: Path, scalar: str | None) -> AnnotationTool | None:
    """Return the tool that recognises a file; None if the scalar of a cloud is named."""
    return None if scalar is not None and _has_points(path) else tool_of(path)


def _labels_of(
    path: Path,
    tool: AnnotationTool | None,
    scan: Scan,
    meanings: LabelIds,
    space: LabelSpace,
    scalar: str | None,
) -> ToolLabels:
    """Read a file as its tool saves it; one of no tool is a cloud or an array.

    `meanings` are those of raw ids, or of the ids that the user stated.
    """
    if tool is not None:
        labels = tool.read(path, scan, space)
        if meanings.is_stated:
            return replace(labels, meanings=meanings)
        if labels.doubt:
            log.warning("%s: %s", path, labels.doubt)
        return labels
    is_cloud = _has_points(path)
    if is_cloud:
        cloud = LabelledCloud.read(path, scalar, scan.notes.frame)
    else:
        cloud = _array_in_order(path, scan.points)
    meanings = meanings.for_cloud(cloud)
    return ToolLabels(cloud=cloud, meanings=meanings, is_in_order=not is_cloud)


def _array_in_order(path: Path, points: Float) -> LabelledCloud:
    """Read an array with one label for each point, in order."""
    values: npt.NDArray[np.integer] = read_integers(path)
    if len(values) != len(points):
        problem = f"has {counted(len(values), 'label')}"
        expected = f"{len(points):,}"
        hint = "use the labels that belong to this scan"
        raise LabelError(path, problem, f"{expected}, one per point of the scan", hint)
    return LabelledCloud(points=points, ids=whole_numbers(values, path, "label"), scalar="labels")


def _unknown_ids(
    path: Path, cloud: LabelledCloud, unknown: dict[int, int], meanings: LabelIds, space: LabelSpace
) -> LabelError:
    """Return the error of ids without a meaning; `unknown` has their numbers of points."""
    if not cloud.has_codes:
        listed = ", ".join(f"{i} ({counted(n, 'point')})" for i, n in sorted(unknown.items()))
        hint = f"map the ids of the tool with {argument('ids')}"
        return LabelError(path, f"has unknown label ids {listed}", meanings.described(), hint)
    problem = unknown_codes(unknown, space)
    file = f"a YAML file such as {map_of_codes(cloud.ids, unknown, meanings, space)}"
    hint = f"map all of them to classes with {argument('ids')}, by {file}"
    return LabelError(path, problem, meanings.described(), hint)


def _require_same_scan(path: Path, transfer: LabelTransfer) -> None:
    """Refuse a cloud with too many points that are not in the scan."""
    count = len(transfer.unmatched)
    if count <= MAX_UNMATCHED * transfer.cloud_points:
        return
    distance = float(np.median(transfer.unmatched))
    hint = "use the cloud of this scan, neither moved, turned nor scaled"
    if distance < ROUNDED_M:
        hint = "save it with more digits: its coordinates were probably rounded"
    problem = f"has {count:,} of {transfer.cloud_points:,} points that are not in the scan"
    problem += f", but {distance:.3g} m from its nearest point (median)"
    raise LabelError(path, problem, f"all within {1000 * TOLERANCE_M:g} mm of a point", hint)
