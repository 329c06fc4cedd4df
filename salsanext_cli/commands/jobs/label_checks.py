# SPDX-License-Identifier: MIT
"""Checks of the label files of a submission to SemanticKITTI's benchmark."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import MOVING, LabelSpace
from salsanext_cli.core.classes.label_tables import RAW_ID_COUNT
from salsanext_cli.core.errors import LabelError, SalsanextError
from salsanext_cli.core.texts import MAX_NAMES_SHOWN, counted, first_few, printable, with_hint
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import reading, size_of
from salsanext_cli.io.formats import read_scan, scan_suffix
from salsanext_cli.io.formats.kitti import count_points
from salsanext_cli.io.formats.kitti_labels import read_labels


@dataclass(frozen=True, slots=True, kw_only=True)
class SubmissionProblem:
    """Reason why the benchmark would not accept predictions, and all that it concerns."""

    subjects: tuple[str, ...]  # Files or sequences, at least one
    problem: str
    hint: str
    code: str

    @property
    def texts(self) -> list[str]:
        """Errors in words: one for each subject, or a single one for many."""
        hint = printable(self.hint)
        if len(self.subjects) > MAX_NAMES_SHOWN:
            files = f"{counted(len(self.subjects), 'file')}: {self.problem}"
            return [with_hint(printable(f"{files}: {first_few(self.subjects)}"), hint)]
        return [
            with_hint(printable(f"{subject}: {self.problem}"), hint) for subject in self.subjects
        ]


def grouped_problems(errors: Iterable[SalsanextError]) -> tuple[SubmissionProblem, ...]:
    """Return the problems in errors, one for all files with the same problem."""
    subjects: dict[tuple[str, str, str], list[str]] = {}
    for error in errors:
        expected = f" (expected {error.expected})" if error.expected else ""
        key = (f"{error.problem}{expected}", error.hint, error.code)
        subjects.setdefault(key, []).append(str(error.subject))
    return tuple(
        SubmissionProblem(problem=problem, hint=hint, code=code, subjects=tuple(names))
        for (problem, hint, code), names in subjects.items()
    )


def label_problems(path: Path, scan: Path | None, space: LabelSpace) -> Iterator[SalsanextError]:
    """Yield every reason why the benchmark does not accept a label file.

    Parameters
    ----------
    path : Path
        Label file.
    scan : Path, optional
        Its scan, whose number of points is compared.
    space : LabelSpace
        Classes of the labels.
    """
    try:
        raw = read_labels(path, _point_count(scan) if scan else None)
        with reading(path) as file:
            size = size_of(file)
    except SalsanextError as error:
        yield error
        return
    if size != 4 * len(raw):
        problem = f"has {counted(size // len(raw), 'byte')} per label"
        yield LabelError(path, problem, "4, one uint32 per point", "write the labels as uint32")
    ids = np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()
    unknown = [raw_id for raw_id in ids if raw_id not in space.learning_map]
    if unknown:
        hint = f"write raw ids, not train ids, or give {argument('space')}"
        yield LabelError(path, f"has unknown ids {first_few(unknown)}", "", hint)
    names = {raw_id: space.labels.get(raw_id, "") for raw_id in ids}
    moving = [f"{raw_id} {name}" for raw_id, name in names.items() if name.startswith(MOVING)]
    if moving:
        problem = f"has ids of moving classes, {first_few(moving)}"
        hint = "write the ids of the classes at rest, such as 10 instead of 252"
        yield LabelError(path, problem, "classes of single scans", hint)


def _point_count(scan: Path) -> int:
    """Return the number of points of a scan, of a .bin file without reading it."""
    if scan_suffix(scan.name) == ".bin":
        return count_points(scan)
    return len(read_scan(scan))
