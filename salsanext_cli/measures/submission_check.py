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
from salsanext_cli.formats.kitti import count_points, read_labels


@dataclass(frozen=True, slots=True)
class Problem:
    """Reason why a sequence cannot be submitted."""

    code: str  # missing, length, unreadable, unknown-id or moving
    sequence: str
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

    `stems`: names of the scans that must be there; `files`, `scans`: predicted labels and scans, by
    stem; without a scan, labels are not counted; `space`: classes that may be predicted; `advance`:
    called for each stem.
    """
    found: dict[str, list[str]] = {"length": [], "unreadable": []}
    unknown: list[list[int]] = []
    moving: list[list[int]] = []
    for stem in stems:
        if stem in files:
            try:
                count = _point_count(scans[stem]) if stem in scans else None
                raw = _wide_labels(files[stem], count)
                ids = np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()
                unknown.append([i for i in ids if i not in space.learning_map])
                moving.append([i for i in ids if space.labels.get(i, "").startswith(MOVING)])
            except SalsanextError as error:
                code = "length" if isinstance(error, LabelError) else "unreadable"
                found[code].append(str(error))
        advance()
    yield from _missing(sequence, stems, files, scans)
    for code, errors in found.items():
        if errors:
            others = f" · and {len(errors) - 1} more" if len(errors) > 1 else ""
            yield Problem(code, sequence, len(errors), f"{errors[0]}{others}")
    what = f"ids that {space.name} lacks"
    remedy = "write raw ids, not train ids, or give --label-space"
    yield from _refused_ids("unknown-id", sequence, unknown, what, remedy, space)
    what = "classes that move, which the benchmark of single scans does not know"
    remedy = "give them the ids of their classes at rest, such as 10 instead of 252"
    yield from _refused_ids("moving", sequence, moving, what, remedy, space)


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
        gone = len([stem for stem in lacking if scans and stem not in scans])
        found = f"{len(lacking):,} of {len(stems):,} predictions are missing: {first_few(lacking)}"
        remedy = "predict them"
        if gone:
            remedy = f"{gone} of their scans are missing too: complete the data set"
        yield Problem(
            "missing", sequence, len(lacking), f"sequence {sequence} · {found} · {remedy}"
        )


def _refused_ids(
    code: str,
    sequence: str,
    of_scans: Sequence[Sequence[int]],
    what: str,
    remedy: str,
    space: LabelSpace,
) -> Iterator[Problem]:
    """Yield the problem of ids that the benchmark refuses, if there are any in some scans."""
    if ids := sorted({i for ids in of_scans for i in ids}):
        scans = sum(bool(ids) for ids in of_scans)
        shown = first_few([f"{i} {space.labels.get(i, '')}".rstrip() for i in ids])
        where = f"{what}, in {counted(scans, 'scan')}: {shown}"
        yield Problem(code, sequence, scans, f"sequence {sequence} · {where} · {remedy}")
