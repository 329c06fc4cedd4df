# SPDX-License-Identifier: MIT
"""Paths of scans, labels and results in the folders of SemanticKITTI and in plain ones."""

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from salsanext_cli.errors import NoInputError, OutputError, first_few
from salsanext_cli.files.reading import is_folder, present, reason
from salsanext_cli.formats import SCAN_SUFFIXES, is_table, scan_suffix, suffixes_in_words
from salsanext_cli.formats.recordings import is_recording, recorded_paths, recording_of, sequence_of
from salsanext_cli.results.uncertainty_kinds import UNCERTAINTY

OWN_TABLES = ("scores.txt", "log.csv", "picked.csv")
"""Tables of `eval`, `train` and `pick`, which are scans only if they are named."""
SINGLE_SCAN_STAGES = ("predict", "knn-refine", "uncertainty")
PREDICTION_STAGES = (*SINGLE_SCAN_STAGES, "fuse")  # Stages whose results later stages read
ERROR = "uncertainty/error"
LEAST_CONFIDENCE = "uncertainty/least_confidence"  # 1 − the largest probability
DISAGREEMENT = "uncertainty/disagreement"  # Share of the scans against the label
COLOURINGS = ("label", "truth", "wrong", "intensity", "range", *UNCERTAINTY)
"""Values for the colours of point clouds."""
COLOURS = (*COLOURINGS, "uncertainty")  # "uncertainty": see `ResultFolder.meant_uncertainty`
SUFFIX_OF_FOLDER = {
    "range": ".npy",
    "pixels": ".npy",
    "pixel_labels": ".npy",
    "predictions": ".label",
    "probabilities": ".npy",
    "votes": ".npy",
    "views": ".npy",
    "objects": ".csv",
    **{f"uncertainty/{kind}": ".npy" for kind in UNCERTAINTY},
    "pictures": ".png",
    "ply": ".ply",
    **{f"ply/{name}": ".ply" for name in COLOURINGS},
}
"""Folders of a sequence in an output folder, and the suffix of the files in each."""
OF_LAS = "convert it to .ply: `pdal translate in.las out.ply`"
HINTS = {".gz": "decompress it with gunzip", ".las": OF_LAS, ".laz": OF_LAS}  # On other suffixes
SCAN_FOLDER = "velodyne"


def names_in(folder: Path) -> list[str]:
    """Return the names of the files in a folder that are not hidden."""
    # Not is_file(): a link to a missing scan must fail when it is read.
    with os.scandir(folder) as entries:
        return [e.name for e in entries if not e.name.startswith(".") and not is_folder(e)]


def counted_by_suffix(paths: Iterable[Path]) -> str:
    """Return the numbers of files by suffix, in words."""
    counts = sorted(Counter(path.suffix.lower() for path in paths).items())
    return ", ".join(f"{count} {suffix or 'without a suffix'}" for suffix, count in counts)


def _no_scans_error(source: Path, others: list[Path]) -> NoInputError:
    """Return the error of a source without scans, with the other files in it."""
    expected = f"{suffixes_in_words()} files, or sequences/*/velodyne"
    inside = sorted(filter(is_recording, source.iterdir())) if source.is_dir() else []
    if inside:
        problem = f"contains no scans, but recordings: {first_few([r.name for r in inside])}"
        return NoInputError(source, problem, expected, f"give one recording, such as {inside[0]}")
    problem = f"contains no scans{f', but {counted_by_suffix(others)}' if others else ''}"
    return NoInputError(source, problem, f"{expected}, or a recording")


@dataclass(frozen=True, slots=True, order=True)
class ScanFile:
    """One scan on disk; sorted by sequence and stem."""

    sequence: str  # Name of its sequence
    stem: str  # File name without suffix; unique within the sequence
    path: Path  # Absolute; for a scan in a recording, the recording with topic and time

    @property
    def name(self) -> str:
        """Sequence and stem, ``08/000000``, the name in records and messages."""
        return f"{self.sequence}/{self.stem}"

    @property
    def label_path(self) -> Path:
        """Path of the labels of the scan, which may not exist."""
        name = f"{self.stem}.label"
        folder = self.path.parent
        if folder.name == SCAN_FOLDER:
            return folder.parent / "labels" / name
        nested = folder / "labels" / name
        return nested if present(nested) else folder / name


def drive_order(file: ScanFile) -> tuple[Any, ...]:
    """Return a key that sorts scan 10 of a drive after scan 9."""
    words = re.split(r"(\d+)", file.stem)
    return file.sequence, [int(word) if word.isdecimal() else word for word in words], file.stem


def find_scans(
    source: Path, sequences: Collection[str] | None = None, *, unique: bool = True
) -> list[ScanFile]:
    """Find the scans of a file, folder, data set or recording, sorted.

    `unique`: whether to refuse several files of one name.
    """
    try:
        is_file = present(source) and not source.is_dir()
        if is_file and not recording_of(_absolute(source)) and not scan_suffix(source.name):
            suffix = source.suffix
            problem = f"{suffix} files are not supported" if suffix else "has no suffix"
            hint = HINTS.get(suffix.lower(), "convert it to .ply, for example with CloudCompare")
            raise NoInputError(source, problem, f"one of {suffixes_in_words()}", hint)
        scans = sorted(_scans_of(_absolute(source)))
        others = names_in(source) if not scans and source.is_dir() else []
    except OSError as error:
        raise NoInputError(source, reason(error), "a scan or a folder of scans") from error
    if not scans:
        raise _no_scans_error(source, [source / name for name in others])
    if sequences is not None:
        scans = of_sequences(scans, sequences, source)
    if unique:
        require_unique_stems(scans)
    return scans


def _absolute(path: Path) -> Path:
    """Make a path absolute without following links, unless it contains ``..``."""
    # Path.resolve() fails at a link to itself, which the reader of that scan refuses.
    return Path(os.path.realpath(path)) if ".." in path.parts else path.absolute()


def _scans_of(path: Path) -> Iterator[ScanFile]:
    if recording := recording_of(path):
        for scan in recorded_paths(path):
            yield ScanFile(sequence_of(recording), scan.name, scan)
    elif not path.is_dir():
        path.stat()
        if suffix := scan_suffix(path.name):
            yield ScanFile(_sequence_of(path.parent), path.name[: -len(suffix)], path)
    else:
        # A `sequences` folder without scans may contain results.
        of_data_set = [*_scans_of_sequences(path / "sequences")]
        yield from of_data_set or [*_scans_in(path / SCAN_FOLDER)] or _scans_at(path)


def require_none_hidden(root: Path) -> None:
    """Refuse to write sequences of scans into a folder if they would hide other scans there."""
    place = _absolute(root)
    first = next(_scans_of(place), None) if place.is_dir() else None
    if first is None or is_table(first.path.name):
        return
    if place / "sequences" not in first.path.parents:
        problem = f"contains scans, such as {first.path.name}, that `sequences` would hide"
        raise OutputError(root, problem, "a separate output folder", "use another, such as data/")


def _scans_at(path: Path) -> list[ScanFile]:
    """Return the scans in a folder, else in folders of sequences in it."""
    scans = [*_scans_in(path)]
    clouds = any(not is_table(scan.path.name) for scan in scans[:1])
    # Tables beside folders of sequences are usually no scans.
    return scans if clouds else [*_scans_of_sequences(path)] or scans


def _scans_of_sequences(folder: Path) -> Iterator[ScanFile]:
    if not folder.is_dir():
        return
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if not e.name.startswith(".") and is_folder(e)]
    for name in names:
        yield from _scans_in(folder / name / SCAN_FOLDER)


def _scans_in(folder: Path) -> Iterator[ScanFile]:
    names = names_in(folder) if folder.is_dir() else []
    suffix_of = {name: scan_suffix(name) for name in names if name not in OWN_TABLES}
    known, sequence = {*suffix_of.values()} - {""}, _sequence_of(folder)
    # Tables are often no scans: they count only without clouds, and only of one suffix.
    tables = [*(s for s in SCAN_SUFFIXES if s in known), *sorted(known)][:1]
    suffixes = [suffix for suffix in known if not is_table(suffix)] or tables
    for name, suffix in suffix_of.items():
        if suffix in suffixes:
            yield ScanFile(sequence, name[: -len(suffix)], folder / name)


def _sequence_of(folder: Path) -> str:
    """Return the name of the sequence of a folder of scans; the root of a disk has no name."""
    named = folder.parent.name if folder.name == SCAN_FOLDER else ""
    return named or folder.name or "scans"


def of_sequences(
    scans: list[ScanFile], sequences: Collection[str], source: object
) -> list[ScanFile]:
    """Return the scans of some sequences; "8" also means "08"."""
    existing = {scan.sequence for scan in scans}
    chosen: set[str] = set()
    for name in sequences:
        same = (e for e in existing if name.isdecimal() and e.isdecimal() and int(e) == int(name))
        matches = {name} & existing or {*same}
        if not matches:
            expected = f"one of {', '.join(sorted(existing))}"
            raise NoInputError(source, f"has no scans of sequence {name}", expected)
        chosen |= matches
    return [scan for scan in scans if scan.sequence in chosen]


def require_unique_stems(scans: list[ScanFile]) -> None:
    """Refuse several scans of one name among sorted scans."""
    for name, group in groupby(scans, lambda scan: scan.name):
        paths = [scan.path for scan in group]
        if len(paths) > 1:
            problem = f"{len(paths)} files of this name: {', '.join(map(str, paths))}"
            raise OutputError(name, problem, "one file per scan", "move or rename the others")


def output_path(out: Path, sequence: str, folder: str, stem: str) -> Path:
    """Return the path of the result of a scan in a folder, a key of `SUFFIX_OF_FOLDER`."""
    for name in (sequence, stem):
        if name in ("", ".", "..") or "\0" in name or Path(name).name != name:
            raise OutputError(repr(name), "is no file name", "a plain name without slashes")
    return out / "sequences" / sequence / folder / f"{stem}{SUFFIX_OF_FOLDER[folder]}"


def find_outputs(out: Path, folder: str) -> dict[tuple[str, str], Path]:
    """Return the results in a folder of all sequences, by sequence and stem, sorted."""
    if not present(out / "sequences"):
        return {}
    suffix = SUFFIX_OF_FOLDER[folder]
    paths = {
        (sequence.name, path.name.removesuffix(suffix)): path
        for sequence in (out / "sequences").glob("*")
        for path in (sequence / folder).glob(f"[!.]*{suffix}")
    }
    return dict(sorted(paths.items()))


def with_outputs(scans: Iterable[ScanFile], out: Path, *folders: str) -> list[ScanFile]:
    """Return the scans that have a result in one of some folders of an output folder."""
    keys = {key for name in folders for key in find_outputs(out, name)}
    return [scan for scan in scans if (scan.sequence, scan.stem) in keys]
