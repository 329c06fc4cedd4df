# SPDX-License-Identifier: MIT
"""Checks of the label files of a submission to SemanticKITTI's benchmark."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import MOVING, LabelSpace
from salsanext_cli.core.classes.label_tables import RAW_ID_COUNT
from salsanext_cli.core.errors import LabelError, SalsanextError
from salsanext_cli.core.texts import MAX_LISTED_NAMES, counted, first_few, printable, with_hint
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import reading, size_of
from salsanext_cli.io.formats import read_scan, scan_suffix
from salsanext_cli.io.formats.kitti import count_points
from salsanext_cli.io.formats.kitti_labels import read_labels


class ProblemKind(StrEnum):
    """Why the benchmark would not accept predictions."""

    MISSING = "predictions are missing"
    UNREADABLE = "the file cannot be read"
    COUNT = "numbers of labels and points differ"
    WIDTH = "the labels do not have four bytes"
    UNKNOWN = "unknown ids"
    MOVING = "ids of moving classes"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassifiedError:
    """Error of one file or sequence, with its kind."""

    kind: ProblemKind
    error: SalsanextError


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemCase:
    """One file or sequence that has a problem."""

    subject: str
    problem: str
    hint: str
    code: str  # Of the error


@dataclass(frozen=True, slots=True, kw_only=True)
class SubmissionProblem:
    """All cases of one kind of problem."""

    kind: ProblemKind
    cases: tuple[ProblemCase, ...]  # At least one

    @property
    def text(self) -> str:
        """The problem in words, with its number of cases, all sequences, and the first files.

        A hint follows the last case in a row that has it.
        """
        most = len(self.cases) if self.kind is ProblemKind.MISSING else MAX_LISTED_NAMES
        lines: list[str] = []
        indent = "" if len(self.cases) == 1 else "  "
        for hint, members in groupby(self.cases[:most], lambda case: case.hint):
            texts = [printable(f"{indent}{case.subject}: {case.problem}") for case in members]
            lines.append(with_hint("\n".join(texts), printable(hint)))
        if len(self.cases) == 1:
            return lines[0]
        if len(self.cases) > most:
            lines.append(f"  and {len(self.cases) - most:,} more")
        return "\n".join((f"{counted(len(self.cases), 'case')}: {self.kind}", *lines))


def grouped_problems(problems: Iterable[ClassifiedError]) -> tuple[SubmissionProblem, ...]:
    """Group problems by kind, in the order of the first of each."""
    cases: dict[ProblemKind, list[ProblemCase]] = {}
    for problem in problems:
        error = problem.error
        expected = f" (expected {error.expected})" if error.expected else ""
        case = ProblemCase(
            subject=str(error.subject),
            problem=f"{error.problem}{expected}",
            hint=error.hint,
            code=error.code,
        )
        cases.setdefault(problem.kind, []).append(case)
    return tuple(
        SubmissionProblem(kind=kind, cases=tuple(members)) for kind, members in cases.items()
    )


def label_problems(path: Path, scan: Path | None, space: LabelSpace) -> Iterator[ClassifiedError]:
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
    except LabelError as error:
        yield ClassifiedError(kind=ProblemKind.COUNT, error=error)
        return
    except SalsanextError as error:
        yield ClassifiedError(kind=ProblemKind.UNREADABLE, error=error)
        return
    if size != 4 * len(raw):
        problem = f"has {counted(size // len(raw), 'byte')} per label"
        width = LabelError(path, problem, "4, one uint32 per point", "write the labels as uint32")
        yield ClassifiedError(kind=ProblemKind.WIDTH, error=width)
    ids = np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()
    unknown = [raw_id for raw_id in ids if raw_id not in space.learning_map]
    if unknown:
        hint = f"write raw ids, not train ids, or give {argument('space')}"
        ids_error = LabelError(path, f"has unknown ids {first_few(unknown)}", "", hint)
        yield ClassifiedError(kind=ProblemKind.UNKNOWN, error=ids_error)
    names = {raw_id: space.labels.get(raw_id, "") for raw_id in ids}
    moving = [f"{raw_id} {name}" for raw_id, name in names.items() if name.startswith(MOVING)]
    if moving:
        problem = f"has ids of moving classes, {first_few(moving)}"
        hint = "write the ids of the classes at rest, such as 10 instead of 252"
        moving_error = LabelError(path, problem, "classes of single scans", hint)
        yield ClassifiedError(kind=ProblemKind.MOVING, error=moving_error)


def _point_count(scan: Path) -> int:
    """Return the number of points of a scan, of a .bin file without reading it."""
    if scan_suffix(scan.name) == ".bin":
        return count_points(scan)
    return len(read_scan(scan))
