# SPDX-License-Identifier: MIT
"""Check of the predictions of a sequence against what SemanticKITTI's benchmark accepts."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import MOVING, RAW_ID_COUNT, LabelSpace, RawIds
from salsanext_cli.errors import LabelError, SalsanextError, counted, first_few
from salsanext_cli.files.reading import reading, size_of
from salsanext_cli.formats import read_scan, scan_suffix
from salsanext_cli.formats.kitti import count_points
from salsanext_cli.formats.labels import read_labels


@dataclass(frozen=True, slots=True)
class Problem:
    """Reason why a sequence cannot be submitted."""

    # {"missing", "length", "unreadable", "unknown-id", "moving"}: kind of the problem, for programs
    code: str
    sequence: str  # Name of the sequence
    scans: int  # Number of scans that have the problem
    message: str  # Problem and remedy in one line


def problems(
    sequence: str,
    stems: Sequence[str],
    files: Mapping[str, Path],
    scans: Mapping[str, Path],
    space: LabelSpace,
    advance: Callable[[], None] = lambda: None,
) -> Iterator[Problem]:
    """Yield all that is wrong with the predictions of a sequence, one problem of each kind.

    `sequence`: name of the sequence; `stems`: names of the scans that must be there; `files`,
    `scans`: predicted labels and scans, by stem. Scans may be absent: then the number of labels is
    not compared with that of points; `space`: classes that may be predicted; `advance`: called for
    each stem.
    """
    found: dict[str, list[str]] = {"length": [], "unreadable": []}
    ids: dict[str, list[list[int]]] = {"unknown-id": [], "moving": []}
    for stem in stems:
        if stem in files:
            try:
                count = _point_count(scans[stem]) if stem in scans else None
                raw = _wide_labels(files[stem], count)
                for code, wrong in _wrong_ids(raw, space).items():
                    ids[code].append(wrong)
            except SalsanextError as error:
                code = "length" if isinstance(error, LabelError) else "unreadable"
                found[code].append(str(error))
        advance()
    yield from _missing(sequence, stems, files, scans)
    for code, errors in found.items():
        if errors:
            others = f" · and {len(errors) - 1} more" if len(errors) > 1 else ""
            yield Problem(code, sequence, len(errors), f"{errors[0]}{others}")
    for code, of_scans in ids.items():
        yield from _ids(sequence, code, of_scans, space)


def _point_count(scan: Path) -> int:
    return count_points(scan) if scan_suffix(scan.name) == ".bin" else len(read_scan(scan))


def _wide_labels(path: Path, count: int | None) -> RawIds:
    """Read labels of four bytes, which the benchmark counts; others are read elsewhere."""
    raw = read_labels(path, count)
    with reading(path) as file:
        size = size_of(file)
    if size != 4 * len(raw):
        found = f"{counted(size // len(raw), 'byte')} per label"
        raise LabelError(path, found, "4, one uint32 per point", "write them as uint32")
    return raw


def _missing(
    sequence: str, stems: Sequence[str], files: Mapping[str, Path], scans: Mapping[str, Path]
) -> Iterator[Problem]:
    lacking = [stem for stem in stems if stem not in files]
    if not stems:
        message = f"sequence {sequence} · no predictions, and no scans to tell how many are needed"
        yield Problem("missing", sequence, 0, f"{message} · predict it")
    elif lacking:
        gone = [stem for stem in lacking if scans and stem not in scans]
        remedy = f"{len(gone)} of their scans are missing too: complete the data set" * bool(gone)
        parts = (
            f"sequence {sequence}",
            f"{len(lacking):,} of {len(stems):,} predictions are missing: {first_few(lacking)}",
            remedy or "predict them",
        )
        yield Problem("missing", sequence, len(lacking), " · ".join(parts))


def _wrong_ids(raw: RawIds, space: LabelSpace) -> dict[str, list[int]]:
    """Return the ids of a scan's points that the benchmark refuses, by the code of the problem."""
    ids = np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()
    wrong = {
        "unknown-id": [i for i in ids if i not in space.learning_map],
        "moving": [i for i in ids if space.labels.get(i, "").startswith(MOVING)],
    }
    return {code: listed for code, listed in wrong.items() if listed}


def _ids(
    sequence: str, code: str, of_scans: Sequence[Sequence[int]], space: LabelSpace
) -> Iterator[Problem]:
    """Yield the problem of ids that the benchmark refuses, if there are any in some scans."""
    if not of_scans:
        return
    ids = sorted({i for ids in of_scans for i in ids})
    shown = first_few([f"{i} {space.labels.get(i, '')}".rstrip() for i in ids])
    what, remedy = {
        "unknown-id": (
            f"ids that {space.name} lacks",
            "write raw ids, not train ids, or give --label-space",
        ),
        "moving": (
            "classes that move, which the benchmark of single scans does not know",
            "give them the ids of their classes at rest, such as 10 instead of 252",
        ),
    }[code]
    where = f"{what}, in {counted(len(of_scans), 'scan')}: {shown}"
    yield Problem(code, sequence, len(of_scans), f"sequence {sequence} · {where} · {remedy}")
