# SPDX-License-Identifier: MIT
"""Labels inside of LAS scans: their classification, by the codes of a label space."""

import logging
import shlex
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.asprs import train_ids_of_codes
from salsanext_cli.core.classes.label_space import BUILT_IN, LabelSpace, RawIds
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Scan
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import command, setting
from salsanext_cli.io.files.reading import identity, present
from salsanext_cli.io.formats import FORMATS, format_of
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.label_scalars import ASPRS_SCALAR, Ids, LabelIds
from salsanext_cli.io.formats.survey.las_file import read_classification
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


def is_las(path: Path) -> bool:
    """Return whether a path is that of a LAS or LAZ file."""
    return format_of(path.name) is FORMATS["las"]


def classified_scans(files: Sequence[ScanFile], space: LabelSpace) -> list[ScanFile]:
    """Return the LAS scans whose classification has a class of a label space.

    Raises
    ------
    LabelError
        If several classes, or none, have a code.
    """
    las_files = [file for file in files if is_las(file.path)]
    if not las_files:
        return []
    log.log(NOTICE, "reading the classification of %s", counted(len(las_files), "LAS scan"))
    meanings = LabelIds.from_codes(space)
    classified = []
    for file in las_files:
        points = _points_of_codes(file.path, identity(file.path))
        _require_meanings(points, meanings, space, file.path)
        if any(meanings.raw_of[code] != meanings.unlabelled for code in points):
            classified.append(file)
    return classified


def labels_source(file: ScanFile) -> Path:
    """Return the file with the labels of a scan: a LAS scan itself if it has no label file."""
    if is_las(file.path) and not present(file.label_path):
        return file.path
    return file.label_path


def read_scan_labels(file: ScanFile, space: LabelSpace, scan: Scan) -> RawIds:
    """Return the raw ids of the points of a scan from its `labels_source`.

    Parameters
    ----------
    file : ScanFile
        File of the scan.
    space : LabelSpace
        Classes of the labels, which states their codes of the ASPRS.
    scan : Scan
        The scan as it was read, of N points. A LAS file states the classification with it.

    Returns
    -------
    (N,) uint32

    Raises
    ------
    LabelError
        If there are not N labels, or no class or several classes have a code.
    """
    source = labels_source(file)
    if source != file.path or scan.notes.codes is None:
        return read_labels(source, len(scan))
    codes = scan.notes.codes.astype(np.int64)
    meanings = LabelIds.from_codes(space)
    _require_meanings(_counts(codes), meanings, space, source)
    return meanings.to_raw(codes)


@cache
def _points_of_codes(path: Path, _: tuple[object, ...]) -> dict[int, int]:
    """Return the number of points of each code of a LAS file, which is read once."""
    return _counts(read_classification(path).astype(np.int64))


def _counts(codes: Ids) -> dict[int, int]:
    """Return the number of points of each code (N,)."""
    unique, counts = np.unique(codes, return_counts=True)
    return dict(zip(unique.tolist(), counts.tolist(), strict=True))


def _require_meanings(
    points: Mapping[int, int], meanings: LabelIds, space: LabelSpace, path: Path
) -> None:
    """Refuse codes of no class or several ones; `points` has the numbers of points by code."""
    unknown = {code: count for code, count in points.items() if code not in meanings.raw_of}
    if unknown:
        folder = str(path.parent)
        words = shlex.join(["salsanext", "import-labels", folder, folder])
        is_usual = space.name not in BUILT_IN[1:]
        named = () if is_usual else (setting("space", space.name),)
        importing = command(words, setting("ids", "FILE"), *named)
        entries = map_of_codes(np.array([*points]), unknown, meanings, space)
        hint = f"run `{importing}` first, where FILE is a YAML file such as {entries}"
        raise LabelError(path, unknown_codes(unknown, space), meanings.described(), hint)


def unknown_codes(unknown: Mapping[int, int], space: LabelSpace) -> str:
    """Return the problem of codes without a meaning; `unknown` has their numbers of points."""
    shared = {code for code, ids in train_ids_of_codes(space).items() if len(ids) > 1}
    groups = {
        f"codes of several classes of {space.name}": unknown.keys() & shared,
        f"codes of no class of {space.name}": unknown.keys() - shared,
    }
    parts = []
    for meaning, codes in groups.items():
        listed = ", ".join(f"{i} ({counted(unknown[i], 'point')})" for i in sorted(codes))
        parts += [f"{listed}, {meaning}"] if codes else []
    return f"has {ASPRS_SCALAR} {'; '.join(parts)}"


def map_of_codes(
    codes: Ids, unknown: Mapping[int, int], meanings: LabelIds, space: LabelSpace
) -> str:
    """Return entries in YAML that give a class to each of some codes (N,), to be edited.

    A code of several classes has one of them, a code of none the class of unlabelled points.
    """
    several = {code: space.labels[raw] for raw, code in reversed(space.asprs_codes.items())}
    names = dict.fromkeys(unknown, space.names[0]) | several | meanings.names
    return f"{{{', '.join(f'{code}: {names[code]}' for code in np.unique(codes).tolist())}}}"
