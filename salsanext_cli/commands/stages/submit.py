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

from salsanext_cli.commands.jobs.submission_checks import (
    ClassifiedError,
    ProblemKind,
    SubmissionProblem,
    grouped_problems,
    label_problems,
)
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError, NoInputError, UsageError
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.atomic import require_target, writing
from salsanext_cli.io.files.reading import is_folder, present, reading
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.loop.run_options import Progress
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of, is_of_benchmark, unmerged, with_splits

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
    """Predictions that were checked, and packed unless there are problems."""

    scans: int  # Number of scans of the test split
    lengths_checked: bool  # Whether the numbers of labels and points were compared for all scans
    problems: tuple[SubmissionProblem, ...] = ()  # Reasons why nothing was packed

    @property
    def is_packed(self) -> bool:
        """Whether the file was written."""
        return not self.problems


@dataclass(frozen=True, slots=True, kw_only=True)
class RequiredScans:
    """Scans of the test split."""

    names: list[tuple[str, str]]  # Sequence and stem, sorted
    missing: list[NoInputError]  # An error for each sequence without all predictions


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

    Every problem is listed, so that one run shows all of them.

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
    clouds = {(scan.sequence, scan.stem): scan.path for scan in scans}
    unchecked = [name for name in required.names if name not in clouds]
    if unchecked:
        names = first_few(["/".join(name) for name in unchecked])
        problem = f"numbers of labels not checked: no points of {counted(len(unchecked), 'scan')}"
        hint = f"give the whole data set with {argument('dataset')}"
        log.warning("%s", with_hint(f"{problem}: {names}", hint))
    _note_others(required, files)
    steps = count(1)

    def advance() -> None:
        if progress:
            # Each file is checked and packed.
            progress(next(steps), 2 * len(required.names))

    cases = [ClassifiedError(kind=ProblemKind.MISSING, error=error) for error in required.missing]
    for name in required.names:
        if name in files:
            cases += label_problems(files[name], clouds.get(name), space)
        advance()
    problems = grouped_problems(cases)
    if not problems:
        members = {} if description is None else {"description.txt": description}
        for name in required.names:
            members[files[name].relative_to(out).as_posix()] = files[name]
        _write_zip(target, members, advance, overwrite=overwrite)
    return Submission(scans=len(required.names), lengths_checked=not unchecked, problems=problems)


def _note_others(required: RequiredScans, files: Predictions) -> None:
    """Log the predictions of sequences of the test split that are not packed."""
    sequences = {sequence for sequence, _ in required.names}
    others = sorted(
        f"{sequence}/{stem}"
        for sequence, stem in files.keys() - {*required.names}
        if sequence in sequences
    )
    if others:
        text = "not packed: %s of scans that the benchmark does not have: %s"
        log.warning(text, counted(len(others), "prediction"), first_few(others))


def _full_space(out: Path, scans: Sequence[ScanFile], space: LabelSpace | None) -> LabelSpace:
    """Return the label space of the predictions with its splits; refuse merged classes."""
    root = data_set_of(scans[0]) if scans else None
    space = with_splits(ResultFolder(out).provenance.compared_space(scans, space), root)
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


def _required(space: LabelSpace, scans: Sequence[ScanFile], files: Predictions) -> RequiredScans:
    """Return the scans of the test split, and the errors of missing predictions."""
    sequences = space.split(SPLIT)
    if not sequences:
        raise UsageError(f"label space {space.name}", f"has no sequences in split {SPLIT}")
    is_official = is_of_benchmark(space) and space.fits(label_space())
    at_hand = {(scan.sequence, scan.stem) for scan in scans}
    required: list[tuple[str, str]] = []
    errors: list[NoInputError] = []
    for sequence in sorted(sequences):
        stems_at_hand = {stem for name, stem in at_hand if name == sequence}
        stems = set(stems_at_hand)
        if is_official:
            stems |= {f"{number:06d}" for number in range(SCANS_OF_TEST.get(sequence, 0))}
        elif not at_hand:
            stems = {stem for name, stem in files if name == sequence}
        missing = sorted(stem for stem in stems if (sequence, stem) not in files)
        if missing or not stems:
            errors.append(_incomplete(sequence, stems, missing, stems_at_hand))
        required += [(sequence, stem) for stem in sorted(stems)]
    return RequiredScans(names=required, missing=errors)


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
        problem += f"; the data set lacks {counted(absent_scans, 'scan')} of it"
        hint = "complete the data set, then predict the sequence"
    return NoInputError(f"sequence {sequence}", problem, hint=hint)
