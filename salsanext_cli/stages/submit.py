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
)
from salsanext_cli.files.atomic import require_target, writing
from salsanext_cli.files.reading import is_folder, present, reading, size_of
from salsanext_cli.formats import read_scan, scan_suffix
from salsanext_cli.formats.kitti import count_points, read_labels
from salsanext_cli.parallel.run_options import Progress
from salsanext_cli.results.paths import ScanFile, find_outputs
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import data_set_of, space_of, with_splits

LEVEL = 6  # Of compression; given, so that it is that of every Python
SPLIT = "test"
SCANS_OF_TEST = {
    **{"11": 921, "12": 1061, "13": 3281, "14": 631, "15": 1901, "16": 1731},
    **{"17": 491, "18": 1801, "19": 4981, "20": 831, "21": 2721},
}
"""Number of scans of each test sequence of SemanticKITTI, named 000000, 000001, …"""
PROBLEMS = {
    "length": "",
    "unreadable": "",
    "unknown-id": "ids that {1} lacks: {0}; write raw ids, not train ids, or give --label-space",
    "moving": "{0}, which the benchmark of single scans does not know; give the ids of the "
    "classes at rest, such as 10 instead of 252",
}
"""Kinds of problems of label files; of raw ids their description with these and a label space."""
Predictions = dict[tuple[str, str], Path]  # Label files by sequence and stem

log = logging.getLogger(__name__)


def write_zip(path: Path, members: Mapping[str, Path], advance: Callable[[], None]) -> None:
    """Write a ZIP file of files by their names in it, with an entry for each folder before them."""
    with writing(path, durable=True) as file, ZipFile(file, "w", ZIP_DEFLATED) as made:
        folders: set[PurePosixPath] = set()
        for name, member in members.items():
            for parent in reversed(PurePosixPath(name).parents[:-1]):
                if parent not in folders:
                    folders.add(parent)
                    made.mkdir(str(parent), 0o755)
            with reading(member) as opened:
                content = opened.read()
            # Without the time and the mode of the file.
            entry = ZipInfo(name)
            entry.external_attr = (stat.S_IFREG | 0o644) << 16
            made.writestr(entry, content, ZIP_DEFLATED, LEVEL)
            advance()


@dataclass(frozen=True, slots=True)
class Problem:
    """Reason why a sequence cannot be submitted."""

    code: str  # missing, length, unreadable, unknown-id or moving
    sequence: str
    scans: int  # Number of scans that have the problem
    message: str  # Problem and hint in one line


@dataclass(frozen=True, slots=True)
class Submission:
    """Result of packing: a ZIP file, or what is wrong with the predictions."""

    scans: int  # Number of scans that a submission has
    lengths_checked: bool  # Whether all numbers of labels were compared with those of points
    problems: tuple[Problem, ...]  # By sequence; without any, the file is written

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
    """Check the predictions of the test split and pack them for the benchmark if all are right."""
    require_target(target, overwrite, ".zip")
    files = find_outputs(out, "predictions")
    if not files:
        hint = f"run `salsanext predict DATASET {out} --split {SPLIT}` first"
        raise NoInputError(out, "holds no predictions", hint=hint)
    texts = {} if description is None else {"description.txt": description}
    if description is not None and (is_folder(description) or not present(description)):
        raise UsageError(f"--description {description}", "no such file", "a text file")
    scans = _scans_at_hand(out, dataset, files)
    root = data_set_of(scans[0]) if scans else None
    space = with_splits(ResultFolder(out).compared_space(scans, space), root)
    if full := unmerged(space, scans):
        found_classes = f"predictions in the merged classes of {space.name}"
        raise LabelError(out, found_classes, f"those of {full.name}", "predict without --classes")
    expected = _expected(space, scans, files)
    if unseen := sorted(expected.keys() - {scan.sequence for scan in scans}):
        text = (
            "no scans at hand of sequence %s: numbers of labels not compared; --dataset names them"
        )
        log.warning(text, first_few(unseen))
    total = sum(map(len, expected.values()))
    steps = count(1)

    def advance() -> None:
        if progress:
            progress(next(steps), 2 * total)

    found: list[Problem] = []
    for sequence, stems in expected.items():
        labels = {stem: path for (s, stem), path in files.items() if s == sequence}
        points = {scan.stem: scan.path for scan in scans if scan.sequence == sequence}
        found += problems(sequence, stems, labels, points, space, advance)
    if not found:
        members = {
            f"sequences/{sequence}/predictions/{stem}.label": files[sequence, stem]
            for sequence, stems in sorted(expected.items())
            for stem in stems
        }
        write_zip(target, texts | members, advance)
    return Submission(total, not unseen, tuple(found))


def unmerged(space: LabelSpace, scans: Sequence[ScanFile] = ()) -> LabelSpace | None:
    """Return the data set's or the benchmark's classes that these are merged ones of, if so."""
    full = [space_of(scans, space), *([label_space()] if _of_benchmark(space) else [])]
    return next((each for each in full if is_merged(space, each)), None)


def _of_benchmark(space: LabelSpace) -> bool:
    return {*with_splits(space).splits.get(SPLIT, ())} == {*SCANS_OF_TEST}


def _scans_at_hand(out: Path, dataset: Path | None, files: Predictions) -> list[ScanFile]:
    """Find the scans of the predictions, where somebody says where they are now."""
    found: list[ScanFile] = []
    for sequence in sorted({sequence for sequence, _ in files}):
        with suppress(NoInputError):
            found += ResultFolder(out, dataset).scans(sequence)
    if dataset is not None and not found:
        raise NoInputError(dataset, "no scans of the predictions", "a folder with sequences/")
    return found


def _expected(
    space: LabelSpace, scans: Sequence[ScanFile], files: Predictions
) -> dict[str, list[str]]:
    """Return the stems that each sequence of the test split must have, from all that is known."""
    sequences = space.split(SPLIT)
    if not sequences:
        raise UsageError(f"label space {space.name}", f"split {SPLIT} is empty", "its sequences")
    official = _of_benchmark(space) and space.fits(label_space())
    known = SCANS_OF_TEST if official else {}
    stems = {s: {f"{n:06d}" for n in range(known.get(s, 0))} for s in sequences}
    there = [(scan.sequence, scan.stem) for scan in scans] or ([] if official else [*files])
    for sequence, stem in there:
        if sequence in stems:
            stems[sequence].add(stem)
    return {sequence: sorted(named) for sequence, named in stems.items()}


def problems(
    sequence: str,
    stems: Sequence[str],
    files: Mapping[str, Path],
    scans: Mapping[str, Path],
    space: LabelSpace,
    advance: Callable[[], None] = lambda: None,
) -> Iterator[Problem]:
    """Yield what is wrong with the predictions of a sequence, one problem of each kind.

    `stems`: names of the scans that must be there; `files`, `scans`: labels and scans by stem.
    """
    found: dict[str, list[str]] = {code: [] for code in PROBLEMS}
    for stem in stems:
        if stem in files:
            for code, message in _wrong_with(files[stem], scans.get(stem), space):
                found[code].append(message)
        advance()
    if not stems:
        message = f"sequence {sequence}: no predictions, and no scans to tell how many are needed"
        yield Problem("missing", sequence, 0, f"{message}; predict it")
    if lacking := [stem for stem in stems if stem not in files]:
        gone = len([stem for stem in lacking if scans and stem not in scans])
        hint = f"{gone} of their scans are missing too: complete the data set"
        share = f"{len(lacking):,} of {len(stems):,} predictions are missing"
        message = f"sequence {sequence}: {share}: {first_few(lacking)}"
        message += f"; {hint if gone else 'predict them'}"
        yield Problem("missing", sequence, len(lacking), message)
    for code, messages in found.items():
        if messages:
            others = f"; and {len(messages) - 1} more" if len(messages) > 1 else ""
            yield Problem(code, sequence, len(messages), f"{messages[0]}{others}")


def _wrong_with(path: Path, scan: Path | None, space: LabelSpace) -> Iterator[tuple[str, str]]:
    """Yield the code and the description of what is wrong with a label file."""
    try:
        ids = _ids_of(path, scan)
    except SalsanextError as error:
        yield "length" if isinstance(error, LabelError) else "unreadable", error.headline
        return
    names = {i: space.labels.get(i, "") for i in sorted(ids)}
    refused = {
        "unknown-id": [i for i in names if i not in space.learning_map],
        "moving": [i for i, name in names.items() if name.startswith(MOVING)],
    }
    for code, of_code in refused.items():
        if of_code:
            shown = first_few([f"{i} {names[i]}".rstrip() for i in of_code])
            yield code, f"{path}: {PROBLEMS[code].format(shown, space.name)}"


def _ids_of(path: Path, scan: Path | None) -> set[int]:
    """Read the ids of labels of four bytes, which the benchmark counts; others are refused."""
    count = None
    if scan:
        count = count_points(scan) if scan_suffix(scan.name) == ".bin" else len(read_scan(scan))
    raw = read_labels(path, count)
    with reading(path) as file:
        size = size_of(file)
    if size != 4 * len(raw):
        found = f"{counted(size // len(raw), 'byte')} per label"
        raise LabelError(path, found, "4, one uint32 per point", "write them as uint32")
    return {*np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()}
