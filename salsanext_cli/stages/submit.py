# SPDX-License-Identifier: MIT
"""Submission to SemanticKITTI's benchmark: predictions of the test split, checked and packed."""

import logging
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path, PurePosixPath
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from salsanext_cli.classes.label_space import MOVING, RAW_ID_COUNT, LabelSpace, label_space
from salsanext_cli.classes.merging import is_merged
from salsanext_cli.errors import (
    LabelError,
    NoInputError,
    SalsanextError,
    UsageError,
    counted,
    first_few,
    printable,
    with_hint,
)
from salsanext_cli.files.atomic import require_target, writing
from salsanext_cli.files.reading import is_folder, present, reading, size_of
from salsanext_cli.formats import read_scan, scan_suffix
from salsanext_cli.formats.kitti import count_points, read_labels
from salsanext_cli.parallel.run_options import Progress
from salsanext_cli.results.paths import ScanFile, find_outputs
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import data_set_of, space_of, with_splits

LEVEL = 6  # Of compression, so that every Python writes the same bytes
SPLIT = "test"
SCANS_OF_TEST = {
    **{"11": 921, "12": 1061, "13": 3281, "14": 631, "15": 1901, "16": 1731},
    **{"17": 491, "18": 1801, "19": 4981, "20": 831, "21": 2721},
}
"""Number of scans of each test sequence of SemanticKITTI, named 000000, 000001, …"""
Predictions = dict[tuple[str, str], Path]  # Label files by sequence and stem

log = logging.getLogger(__name__)


def _write_zip(path: Path, members: Mapping[str, Path], advance: Callable[[], None]) -> None:
    """Write a ZIP file of members by name, with an entry for each folder before its files."""
    with writing(path, durable=True) as file, ZipFile(file, "w", ZIP_DEFLATED) as made:
        folders: set[PurePosixPath] = set()
        for name, member in members.items():
            for parent in reversed(PurePosixPath(name).parents[:-1]):
                if parent not in folders:
                    folders.add(parent)
                    made.mkdir(str(parent), 0o755)
            with reading(member) as opened:
                content = opened.read()
            # The time and the mode of the file do not change the bytes.
            entry = ZipInfo(name)
            entry.external_attr = (stat.S_IFREG | 0o644) << 16
            made.writestr(entry, content, ZIP_DEFLATED, LEVEL)
            advance()


@dataclass(frozen=True, slots=True)
class Problem:
    """Reason why a sequence cannot be submitted."""

    code: str  # missing, length, unreadable, unknown-id or moving
    sequence: str
    scans: int  # Number of scans with the problem
    message: str
    hint: str

    @property
    def text(self) -> str:
        """Message and hint on two lines."""
        return with_hint(printable(self.message), printable(self.hint))


@dataclass(frozen=True, slots=True)
class Submission:
    """Result of packing: a ZIP file, or the problems of the predictions."""

    scans: int  # Number of scans of the test split
    lengths_checked: bool  # Whether the numbers of labels and points were compared for all scans
    problems: tuple[Problem, ...]  # By sequence; the file is written if there are none

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {"stage": "submit", **asdict(self)}


def submit(
    out: Path,
    target: Path,
    *,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    description: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Submission:
    """Check the predictions of the test split, and pack them for the benchmark if all are right.

    Parameters
    ----------
    out, target : Path
        Output folder with predictions, and ZIP file to write.
    dataset, space, description : Path, LabelSpace, Path, optional
        Data set with the scans, and label space of its labels, if not the recorded ones; text file
        about the method.
    overwrite, progress : bool, callable, optional
        Whether to replace an existing file; function of the number of finished files and of all.

    Returns
    -------
    Submission
        Problems of the predictions; the file is written if there are none.
    """
    require_target(target, overwrite, ".zip")
    files = find_outputs(out, "predictions")
    if not files:
        hint = f"run `salsanext predict DATASET {out} --split {SPLIT}` first"
        raise NoInputError(out, "contains no predictions", hint=hint)
    if description is not None and (is_folder(description) or not present(description)):
        raise UsageError(f"--description {description}", "no such file", "a text file")
    scans = _scans_at_hand(out, dataset, files)
    space = _full_space(out, scans, space)
    expected = _expected(space, scans, files)
    if unseen := sorted(expected.keys() - {scan.sequence for scan in scans}):
        problem = f"no scans of sequence {first_few(unseen)}: numbers of labels not checked"
        log.warning("%s", with_hint(problem, "give --dataset"))
    total, steps = sum(map(len, expected.values())), count(1)

    def advance() -> None:
        if progress:
            progress(next(steps), 2 * total)

    problems: list[Problem] = []
    for sequence, stems in expected.items():
        problems += _problems(sequence, stems, files, scans, space, advance)
    if not problems:
        members = {} if description is None else {"description.txt": description}
        for path in (files[s, stem] for s, stems in sorted(expected.items()) for stem in stems):
            members[path.relative_to(out).as_posix()] = path
        _write_zip(target, members, advance)
    return Submission(total, not unseen, tuple(problems))


def _full_space(out: Path, scans: Sequence[ScanFile], space: LabelSpace | None) -> LabelSpace:
    """Return the label space of the predictions with its splits; refuse merged classes."""
    root = data_set_of(scans[0]) if scans else None
    space = with_splits(ResultFolder(out).compared_space(scans, space), root)
    if full := unmerged(space, scans):
        problem = f"has predictions in the merged classes of {space.name}"
        expected = f"the classes of {full.name}"
        raise LabelError(out, problem, expected, "predict without --classes")
    return space


def unmerged(space: LabelSpace, scans: Sequence[ScanFile] = ()) -> LabelSpace | None:
    """Return the label space whose classes a label space merges, None if it merges none.

    Parameters
    ----------
    space, scans : LabelSpace, sequence of ScanFile
        Label space of predictions, and scans of a data set that may describe another.

    Returns
    -------
    LabelSpace or None
        That of the data set or of the benchmark.
    """
    finer = [space_of(scans, space), *([label_space()] if _is_of_benchmark(space) else [])]
    return next((full for full in finer if is_merged(space, full)), None)


def _is_of_benchmark(space: LabelSpace) -> bool:
    return {*with_splits(space).splits.get(SPLIT, ())} == {*SCANS_OF_TEST}


def _scans_at_hand(out: Path, dataset: Path | None, files: Predictions) -> list[ScanFile]:
    """Find the scans of the predictions, as far as they exist."""
    scans: list[ScanFile] = []
    for sequence in sorted({sequence for sequence, _ in files}):
        with suppress(NoInputError):
            scans += ResultFolder(out, dataset).scans(sequence)
    if dataset is not None and not scans:
        raise NoInputError(dataset, "has no scans of the predictions", "a folder with sequences/")
    return scans


def _expected(
    space: LabelSpace, scans: Sequence[ScanFile], files: Predictions
) -> dict[str, list[str]]:
    """Return the required stems of each sequence of the test split."""
    sequences = space.split(SPLIT)
    if not sequences:
        raise UsageError(f"label space {space.name}", f"has no sequences in split {SPLIT}")
    official = _is_of_benchmark(space) and space.fits(label_space())
    known = SCANS_OF_TEST if official else {}
    stems = {s: {f"{n:06d}" for n in range(known.get(s, 0))} for s in sequences}
    there = [(scan.sequence, scan.stem) for scan in scans] or ([] if official else [*files])
    for sequence, stem in there:
        if sequence in stems:
            stems[sequence].add(stem)
    return {sequence: sorted(names) for sequence, names in stems.items()}


def _problems(
    sequence: str,
    stems: Sequence[str],
    files: Predictions,
    scans: Sequence[ScanFile],
    space: LabelSpace,
    advance: Callable[[], None],
) -> Iterator[Problem]:
    """Yield the problems of the required stems of a sequence, one of each kind."""
    labels = {stem: path for (name, stem), path in files.items() if name == sequence}
    clouds = {scan.stem: scan.path for scan in scans if scan.sequence == sequence}
    errors: dict[str, list[SalsanextError]] = {}
    for stem in stems:
        if stem in labels:
            for code, error in _errors_of(labels[stem], clouds.get(stem), space):
                errors.setdefault(code, []).append(error)
        advance()
    if not stems:
        message = f"sequence {sequence}: no predictions, and no scans"
        yield Problem("missing", sequence, 0, message, "predict it")
    if missing := [stem for stem in stems if stem not in labels]:
        share = f"{len(missing):,} of {len(stems):,} predictions are missing"
        gone = sum(stem not in clouds for stem in missing) if clouds else 0
        hint = f"complete the data set: {gone} of their scans are missing too"
        message = f"sequence {sequence}: {share}: {first_few(missing)}"
        yield Problem("missing", sequence, len(missing), message, hint if gone else "predict them")
    for code, (first, *others) in errors.items():
        more = f"; and {len(others)} more" if others else ""
        yield Problem(code, sequence, len(others) + 1, f"{first.headline}{more}", first.hint)


def _errors_of(
    path: Path, scan: Path | None, space: LabelSpace
) -> Iterator[tuple[str, SalsanextError]]:
    """Yield the code and the error of each problem of a label file."""
    try:
        ids = _ids_of(path, scan)
    except SalsanextError as error:
        yield "length" if isinstance(error, LabelError) else "unreadable", error
        return
    if unknown := [str(i) for i in ids if i not in space.learning_map]:
        hint = "write raw ids, not train ids, or give --label-space"
        yield "unknown-id", LabelError(path, f"has unknown ids {first_few(unknown)}", "", hint)
    names = {i: space.labels.get(i, "") for i in ids}
    if moving := [f"{i} {name}" for i, name in names.items() if name.startswith(MOVING)]:
        problem = f"has ids of moving classes, {first_few(moving)}"
        hint = "write the ids of the classes at rest, such as 10 instead of 252"
        yield "moving", LabelError(path, problem, "classes of single scans", hint)


def _ids_of(path: Path, scan: Path | None) -> list[int]:
    """Read the raw ids of a label file; refuse other labels than uint32, as the benchmark does."""
    count = None
    if scan:
        count = count_points(scan) if scan_suffix(scan.name) == ".bin" else len(read_scan(scan))
    raw = read_labels(path, count)
    with reading(path) as file:
        size = size_of(file)
    if size != 4 * len(raw):
        problem = f"has {counted(size // len(raw), 'byte')} per label"
        raise LabelError(path, problem, "4, one uint32 per point", "write the labels as uint32")
    return list(np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist())
