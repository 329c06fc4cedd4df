# SPDX-License-Identifier: MIT
"""Submission to SemanticKITTI's benchmark: predictions of the test split, checked and packed."""

import logging
import stat
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from salsanext_cli.core.classes.label_space import MOVING, LabelSpace
from salsanext_cli.core.classes.label_tables import RAW_ID_COUNT
from salsanext_cli.core.errors import LabelError, NoInputError, UsageError
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.atomic import require_target, writing
from salsanext_cli.io.files.reading import is_folder, present, reading, size_of
from salsanext_cli.io.formats import read_scan, scan_suffix
from salsanext_cli.io.formats.kitti import count_points
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.loop.run_options import Progress
from salsanext_cli.runs.results.paths import ScanFile, find_outputs
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.selection import data_set_of, is_of_benchmark, unmerged, with_splits

LEVEL = 6  # Of compression, so that every Python writes the same bytes
SPLIT = "test"
SCANS_OF_TEST = {
    "11": 921,
    "12": 1061,
    "13": 3281,
    "14": 631,
    "15": 1901,
    "16": 1731,
    "17": 491,
    "18": 1801,
    "19": 4981,
    "20": 831,
    "21": 2721,
}
"""Number of scans of each test sequence of SemanticKITTI, named 000000, 000001, …"""
Predictions = dict[tuple[str, str], Path]  # Label files by sequence and stem

log = logging.getLogger(__name__)


def _write_zip(
    path: Path, members: Mapping[str, Path], advance: Callable[[], None], *, overwrite: bool
) -> None:
    """Write a ZIP file of members by name, with an entry for each folder before its files."""
    with (
        writing(path, durable=True, overwrite=overwrite) as file,
        ZipFile(file, "w", ZIP_DEFLATED) as archive,
    ):
        folders: set[PurePosixPath] = set()
        for name, member in members.items():
            for parent in reversed(PurePosixPath(name).parents[:-1]):
                if parent not in folders:
                    folders.add(parent)
                    archive.mkdir(str(parent), 0o755)
            with reading(member) as member_file:
                content = member_file.read()
            # The time and the mode of the file do not change the bytes.
            entry = ZipInfo(name)
            entry.external_attr = (stat.S_IFREG | 0o644) << 16
            archive.writestr(entry, content, ZIP_DEFLATED, LEVEL)
            advance()


@dataclass(frozen=True, slots=True, kw_only=True)
class Submission:
    """Predictions that were checked and packed."""

    scans: int  # Number of scans of the test split
    lengths_checked: bool  # Whether the numbers of labels and points were compared for all scans


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
    out : Path
        Output folder with predictions.
    target : Path
        ZIP file to write.
    dataset : Path, optional
        Data set with the scans, if it is not the recorded one.
    space : LabelSpace, optional
        Label space of its labels, if it is not the recorded one.
    description : Path, optional
        Text file about the method.
    overwrite : bool, optional
        Whether to replace an existing file.
    progress : callable, optional
        Function of the number of finished files and of all files.

    Returns
    -------
    Submission
    """
    require_target(target, overwrite, ".zip")
    files = find_outputs(out, "predictions")
    if not files:
        predict = command(f"salsanext predict DATASET {out}", setting("split", SPLIT))
        hint = f"run `{predict}` first"
        raise NoInputError(out, "contains no predictions", hint=hint)
    if description is not None and (is_folder(description) or not present(description)):
        subject = f"{argument('description')} {description}"
        raise UsageError(subject, "no such file", "a text file")
    scans = _scans_at_hand(out, dataset, files)
    space = _full_space(out, scans, space)
    required = _required(space, scans, files)
    sequences_at_hand = {scan.sequence for scan in scans}
    unchecked = sorted({sequence for sequence, _ in required} - sequences_at_hand)
    if unchecked:
        problem = f"no scans of sequence {first_few(unchecked)}: numbers of labels not checked"
        log.warning("%s", with_hint(problem, f"give {argument('dataset')}"))
    clouds = {(scan.sequence, scan.stem): scan.path for scan in scans}
    members = {} if description is None else {"description.txt": description}
    steps = count(1)

    def advance() -> None:
        if progress:
            # Each file is checked and packed.
            progress(next(steps), 2 * len(required))

    for name in required:
        _check_labels(files[name], clouds.get(name), space)
        members[files[name].relative_to(out).as_posix()] = files[name]
        advance()
    _write_zip(target, members, advance, overwrite=overwrite)
    return Submission(scans=len(required), lengths_checked=not unchecked)


def _full_space(out: Path, scans: Sequence[ScanFile], space: LabelSpace | None) -> LabelSpace:
    """Return the label space of the predictions with its splits; refuse merged classes."""
    root = data_set_of(scans[0]) if scans else None
    space = with_splits(ResultFolder(out).manifest.compared_space(scans, space), root)
    full = unmerged(space, scans)
    if full:
        problem = f"has predictions in the merged classes of {space.name}"
        expected = f"the classes of {full.name}"
        hint = f"predict without {argument('classes')}"
        raise LabelError(out, problem, expected, hint)
    return space


def _scans_at_hand(out: Path, dataset: Path | None, files: Predictions) -> list[ScanFile]:
    """Find the scans of the predictions, as far as they exist."""
    scans: list[ScanFile] = []
    for sequence in sorted({sequence for sequence, _ in files}):
        with suppress(NoInputError):
            scans += ResultFolder(out, dataset).scans(sequence)
    if dataset is not None and not scans:
        raise NoInputError(dataset, "has no scans of the predictions", "a folder with sequences/")
    return scans


def _required(
    space: LabelSpace, scans: Sequence[ScanFile], files: Predictions
) -> list[tuple[str, str]]:
    """Return the sorted sequences and stems of the test split; refuse missing predictions."""
    sequences = space.split(SPLIT)
    if not sequences:
        raise UsageError(f"label space {space.name}", f"has no sequences in split {SPLIT}")
    is_official = is_of_benchmark(space) and space.fits(label_space())
    at_hand = {(scan.sequence, scan.stem) for scan in scans}
    required = []
    for sequence in sorted(sequences):
        stems_at_hand = {stem for name, stem in at_hand if name == sequence}
        stems = set(stems_at_hand)
        if is_official:
            stems |= {f"{number:06d}" for number in range(SCANS_OF_TEST.get(sequence, 0))}
        elif not at_hand:
            stems = {stem for name, stem in files if name == sequence}
        missing = sorted(stem for stem in stems if (sequence, stem) not in files)
        if missing or not stems:
            raise _incomplete(sequence, stems, missing, stems_at_hand)
        required += [(sequence, stem) for stem in sorted(stems)]
    return required


def _incomplete(
    sequence: str, stems: Collection[str], missing: Sequence[str], at_hand: Collection[str]
) -> NoInputError:
    """Return the error of a sequence without all predictions; `at_hand`: stems of its scans."""
    problem = "has neither predictions nor scans"
    if stems:
        share = f"lacks {len(missing):,} of {counted(len(stems), 'prediction')}"
        problem = f"{share}: {first_few(missing)}"
    hint = "predict the sequence"
    absent_scans = len({*missing} - {*at_hand}) if at_hand else 0
    if absent_scans:
        hint = f"complete the data set: it lacks {counted(absent_scans, 'scan')}"
    return NoInputError(f"sequence {sequence}", problem, hint=hint)


def _check_labels(path: Path, scan: Path | None, space: LabelSpace) -> None:
    """Refuse labels that the benchmark does not accept."""
    raw = read_labels(path, _point_count(scan) if scan else None)
    with reading(path) as file:
        size = size_of(file)
    if size != 4 * len(raw):
        problem = f"has {counted(size // len(raw), 'byte')} per label"
        raise LabelError(path, problem, "4, one uint32 per point", "write the labels as uint32")
    ids = np.flatnonzero(np.bincount(raw & 0xFFFF, minlength=RAW_ID_COUNT)).tolist()
    unknown = [raw_id for raw_id in ids if raw_id not in space.learning_map]
    if unknown:
        hint = f"write raw ids, not train ids, or give {argument('space')}"
        raise LabelError(path, f"has unknown ids {first_few(unknown)}", "", hint)
    names = {raw_id: space.labels.get(raw_id, "") for raw_id in ids}
    moving = [f"{raw_id} {name}" for raw_id, name in names.items() if name.startswith(MOVING)]
    if moving:
        problem = f"has ids of moving classes, {first_few(moving)}"
        hint = "write the ids of the classes at rest, such as 10 instead of 252"
        raise LabelError(path, problem, "classes of single scans", hint)


def _point_count(scan: Path) -> int:
    """Return the number of points of a scan, of a .bin file without reading it."""
    if scan_suffix(scan.name) == ".bin":
        return count_points(scan)
    return len(read_scan(scan))
