# SPDX-License-Identifier: MIT
"""Search for scans in files, folders, data sets, recordings and lists."""

import os
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.files.reading import present, reason
from salsanext_cli.io.formats import is_table, scan_suffix
from salsanext_cli.io.formats.recordings import recorded_paths, recording_of, sequence_of
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER, layout_of, sequence_name
from salsanext_cli.runs.scans.scan_file import ScanFile, require_unique_stems
from salsanext_cli.runs.scans.scan_folders import (
    CERTAIN,
    MAX_ENTRIES_BESIDE_SCANS,
    MAX_ENTRIES_BESIDE_TABLES,
    ScanFolder,
    ambiguous_folders,
    folders_in,
    folders_of_one_name,
    names_in,
    no_scans_error,
    other_files_below,
    scan_names,
    search_below,
    unread_file_error,
    usable,
    words_of_choice,
    words_of_drives,
    words_of_others,
)
from salsanext_cli.runs.scans.scan_list import list_of, listed_paths


def find_scans(
    source: Path, sequences: Collection[str] | None = None, *, unique: bool = True
) -> list[ScanFile]:
    """Find the scans of a file, folder, data set, recording or list (see `scan_list`), sorted.

    `unique`: whether to refuse several files of one name.
    """
    file_of_list = list_of(source)
    scans = _scans_at_source(source) if file_of_list is None else _scans_of_list(file_of_list)
    if sequences is not None:
        scans = scans_of_sequences(scans, sequences, source)
    if unique:
        require_unique_stems(scans)
    return scans


def _scans_at_source(source: Path) -> list[ScanFile]:
    """Return the scans of anything but a list, sorted."""
    try:
        root = _absolute(source)  # Messages name the source as the user gave it
        is_file = present(source) and not source.is_dir()
        if is_file and not recording_of(root) and not scan_suffix(source.name):
            raise unread_file_error(source)
        scans = sorted(_scans_of(root))
        if source.is_dir():
            has_clouds = bool(scans) and not is_table(scans[0].path.name)
            find_others = _with_scans_elsewhere if has_clouds else _scans_below
            scans = find_others(source, root, scans)
        others = names_in(source) if not scans and source.is_dir() else []
    except OSError as error:
        raise NoInputError(source, reason(error), "a scan or a folder of scans") from error
    if not scans:
        raise no_scans_error(source, others)
    return scans


def _scans_of_list(path: Path) -> list[ScanFile]:
    """Return the scans that a text file lists, sorted, without repetitions."""
    scans: set[ScanFile] = set()
    for listed in listed_paths(path):
        with listed.naming_line():
            scans.update(_scans_at_source(listed.path))
    return sorted(scans)


def scans_at_top(folder: Path) -> list[ScanFile]:
    """Return the scans that lie in a folder or a topic itself, sorted.

    Unlike `find_scans`, it neither looks for scans below nor prints a line about them.
    """
    if recording_of(folder):
        return [scan for scan in find_scans(folder, unique=False) if scan.path.parent == folder]
    try:
        return sorted(_scans_in(folder))
    except OSError as error:
        raise NoInputError(folder, reason(error), "a folder of scans") from error


def _absolute(path: Path) -> Path:
    """Make a path absolute without following links, unless it contains ``..``."""
    # Path.resolve() fails at a link to itself, which the reader of that scan refuses.
    return Path(os.path.realpath(path)) if ".." in path.parts else path.absolute()


def _scans_of(path: Path) -> Iterator[ScanFile]:
    if recording := recording_of(path):
        for scan in recorded_paths(path):
            yield ScanFile(sequence=sequence_of(recording), stem=scan.name, path=scan)
    elif not path.is_dir():
        path.stat()
        if suffix := scan_suffix(path.name):
            folder = ScanFolder(path.parent, {path.name: suffix})
            yield from _scan_files(folder, sequence_name(path.parent, [path.name]))
    else:
        yield from _scans_of_folder(path)


def _scans_of_folder(path: Path) -> list[ScanFile]:
    """Return the scans of a data set, else of a sequence, else of a folder of scans."""
    # A `sequences` folder without scans may contain results.
    scans_of_data_set = list(_scans_of_sequences(path / "sequences"))
    if scans_of_data_set:
        return scans_of_data_set
    scans_of_sequence = list(_scans_in(path / SCAN_FOLDER))
    return scans_of_sequence or _scans_at(path)


def require_no_hidden_scans(out: Path) -> None:
    """Refuse to write sequences of scans into a folder if they would hide other scans there."""
    absolute = _absolute(out)
    first = next(_scans_of(absolute), None) if absolute.is_dir() else None
    if first is None or is_table(first.path.name):
        return
    if absolute / "sequences" not in first.path.parents:
        problem = f"contains scans, such as {first.path.name}, that `sequences` would hide"
        raise OutputError(out, problem, "a separate output folder", "use another, such as data/")


def _scans_at(path: Path) -> list[ScanFile]:
    """Return the scans in a folder, else in folders of sequences in it."""
    scans = list(_scans_in(path))
    has_clouds = bool(scans) and not is_table(scans[0].path.name)
    if has_clouds:
        return scans
    # Tables beside folders of sequences are usually no scans.
    return list(_scans_of_sequences(path)) or scans


def _scans_of_sequences(folder: Path) -> Iterator[ScanFile]:
    if not folder.is_dir():
        return
    for name in folders_in(folder):
        yield from _scans_in(folder / name / SCAN_FOLDER)


def _scans_in(folder: Path) -> Iterator[ScanFile]:
    suffixes = scan_names(names_in(folder)) if folder.is_dir() else {}
    yield from _scan_files(ScanFolder(folder, suffixes), sequence_name(folder, suffixes))


def _scan_files(folder: ScanFolder, sequence: str) -> Iterator[ScanFile]:
    layout = folder.layout
    for name, suffix in folder.suffixes.items():
        stem = name[: -len(suffix)]
        drive = layout.drive(stem) if layout else ""
        yield ScanFile(sequence=drive or sequence, stem=stem, path=folder.path / name)


def _scans_below(source: Path, root: Path, tables: list[ScanFile]) -> list[ScanFile]:
    """Return the scans of a folder that contains none, or only tables, from the folders below it.

    Tables are the scans unless there is a known layout below.
    """
    if recording_of(root) or (tables and layout_of(root, [scan.path.name for scan in tables])):
        return tables
    if tables:
        return _layout_below(source, root) or tables
    search = search_below(root)
    chosen = [] if search.stopped_after else usable(search.folders)
    if not chosen and search.folders:
        raise ambiguous_folders(source, root, search)
    if not chosen:
        error = other_files_below(source, search)
        if error is not None:
            raise error
        return []
    log_once(words_of_choice(source, root, chosen, search.folders), NOTICE)
    return _scans_of_folders(source, root, chosen)


def _layout_below(source: Path, root: Path) -> list[ScanFile]:
    """Return the scans of the only known layout below a folder of tables; print what is not used.

    Refuse a known layout that a search found before it stopped.
    """
    search = search_below(root, MAX_ENTRIES_BESIDE_TABLES)
    itself = ScanFolder(root, scan_names(names_in(root)))
    layouts = [folder for folder in search.folders if folder.layout]
    if search.stopped_after and layouts:
        tables = itself if itself.suffixes else None
        raise ambiguous_folders(source, root, replace(search, folders=layouts), tables)
    if chosen := usable(layouts):
        log_once(words_of_choice(source, root, chosen, [itself, *search.folders]), NOTICE)
        return _scans_of_folders(source, root, chosen)
    clouds = [folder for folder in search.folders if folder.rank == CERTAIN]
    if words := words_of_others(source, root, clouds, 0):
        log_once(words, NOTICE)
    return []


def _scans_of_folders(source: Path, root: Path, folders: Iterable[ScanFolder]) -> list[ScanFile]:
    """Return the scans of folders below a root; refuse several folders of one sequence."""
    scans: list[ScanFile] = []
    for folder in folders:
        name = sequence_name(folder.path, folder.suffixes)
        if folder.layout:
            name = folder.layout.sequence_below(folder.path, root)
        scans += _scan_files(folder, name)
    _require_a_folder_each(source, root, scans)
    return sorted(scans)


def _require_a_folder_each(source: Path, root: Path, scans: Iterable[ScanFile]) -> None:
    """Refuse scans of one sequence in several folders, which results could not tell apart."""
    by_sequence: dict[str, dict[Path, dict[str, str]]] = {}
    for scan in scans:
        names = by_sequence.setdefault(scan.sequence, {}).setdefault(scan.path.parent, {})
        names[scan.path.name] = scan.path.name[len(scan.stem) :]
    for sequence, names_by_folder in sorted(by_sequence.items()):
        if len(names_by_folder) > 1:
            folders = [ScanFolder(path, names) for path, names in sorted(names_by_folder.items())]
            raise folders_of_one_name(source, root, sequence, folders)


def _with_scans_elsewhere(source: Path, root: Path, scans: list[ScanFile]) -> list[ScanFile]:
    """Return scans with those of deeper folders of drives; print a line about other folders.

    Drives in ``ROOT/*/velodyne`` are a collection, to which deeper drives belong. Other drives
    below a sequence, a data set or a folder of scans are only named.
    """
    if recording_of(root):
        return scans
    used = {scan.path.parent for scan in scans}
    search = search_below(root, MAX_ENTRIES_BESIDE_SCANS, skipped=used)
    others = [folder for folder in search.folders if folder.rank == CERTAIN]
    itself = ScanFolder(root, {} if root in used else scan_names(names_in(root)))
    if itself.suffixes and itself.rank == CERTAIN:
        others.insert(0, itself)
    is_collection = all(path.parent.parent == root for path in used)
    drives = [folder for folder in others if is_collection and _is_drive(folder.path)]
    others = [folder for folder in others if folder not in drives]
    if drives:
        log_once(words_of_drives(source, root, drives), NOTICE)
        scans = sorted([*scans, *_scans_of_folders(source, root, drives)])
        _require_a_folder_each(source, root, scans)
    if words := words_of_others(source, root, others, search.stopped_after):
        log_once(words, NOTICE)
    return scans


def _is_drive(folder: Path) -> bool:
    """Return whether a folder of scans is that of a drive, and not of a data set of its own."""
    return folder.name == SCAN_FOLDER and folder.parent.parent.name != "sequences"


def scans_of_sequences(
    scans: list[ScanFile], sequences: Collection[str], source: object
) -> list[ScanFile]:
    """Return the scans of some sequences; "8" also means "08"."""
    existing = {scan.sequence for scan in scans}
    numbers = {sequence: int(sequence) for sequence in existing if sequence.isdecimal()}
    chosen: set[str] = set()
    for name in sequences:
        matches = {name} & existing
        if not matches and name.isdecimal():
            matches = {sequence for sequence in numbers if numbers[sequence] == int(name)}
        if not matches:
            expected = f"one of {', '.join(sorted(existing))}"
            raise NoInputError(source, f"has no scans of sequence {name}", expected)
        chosen |= matches
    return [scan for scan in scans if scan.sequence in chosen]
