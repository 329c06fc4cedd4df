# SPDX-License-Identifier: MIT
"""Folders that contain scans: the files in one that are scans, and folders below another one."""

import os
import shlex
from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from operator import attrgetter
from pathlib import Path

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.core.texts import MAX_LISTED_NAMES, first_few
from salsanext_cli.io.annotation_tools.registry import TOOLS
from salsanext_cli.io.files.reading import is_folder, present
from salsanext_cli.io.formats import SCAN_SUFFIXES, is_table, scan_suffix, suffixes_in_words
from salsanext_cli.io.formats.recording_kinds import RECORDING_SUFFIXES
from salsanext_cli.io.formats.recordings import is_recording
from salsanext_cli.io.formats.unread import (
    UNFINISHED,
    UNREAD_SUFFIXES,
    conversion_hint,
    folder_hint,
    unread_kind,
)
from salsanext_cli.runs.scans.layouts import (
    LABEL_FOLDER,
    PICK_RECORD,
    SCAN_FOLDER,
    TOOL_FOLDER,
    Layout,
    layout_of,
)

OWN_TABLES = ("scores.txt", "log.csv", "picked.csv")
"""Tables of `eval`, `train` and `pick`, which are scans only if they are named."""
FILE_LISTS = ".salsanext.files"
"""Folder with the lists of written files, in the root of folders that stages fill."""
LABEL_SUFFIX = ".label"
TEXT_SUFFIXES = (".txt", ".csv", ".asc", ".pts")
"""Suffixes of tables that are usually no scans."""
CERTAIN = 2  # Rank of clouds and of files in a known layout
LIKELY = 1  # Rank of arrays
UNLIKELY = 0  # Rank of texts
MAX_DEPTH = 6
MAX_ENTRIES = 1_000_000
"""Files and folders that a search looks at, some ten seconds of work."""
MAX_ENTRIES_BESIDE_TABLES = 20_000
"""The same below a folder of tables, which are probably the scans."""
MAX_ENTRIES_BESIDE_SCANS = 200_000
"""The same beside folders of scans, of which others are only named."""


def names_in(folder: Path) -> list[str]:
    """Return the names of the files in a folder that are not hidden."""
    # Not is_file(): a link to a missing scan must fail when it is read.
    with os.scandir(folder) as entries:
        return [e.name for e in entries if not e.name.startswith(".") and not is_folder(e)]


def folders_in(folder: Path) -> list[str]:
    """Return the sorted names of the folders in a folder that are not hidden."""
    with os.scandir(folder) as entries:
        return sorted(e.name for e in entries if not e.name.startswith(".") and is_folder(e))


def scan_names(names: Iterable[str]) -> dict[str, str]:
    """Return the suffixes of the files in a folder that are scans, by name.

    Tables are often no scans: they count only without clouds, and only of one suffix.
    """
    # Most of a million names have one of a few endings.
    suffix_of_ending = cache(scan_suffix)
    suffixes = {
        name: suffix_of_ending("".join(name.partition(".")[1:]))
        for name in names
        if name not in OWN_TABLES
    }
    present_suffixes = {*suffixes.values()} - {""}
    built_in = [suffix for suffix in SCAN_SUFFIXES if suffix in present_suffixes]
    first_table = [*built_in, *sorted(present_suffixes)][:1]
    chosen = [suffix for suffix in present_suffixes if not is_table(suffix)] or first_table
    return {name: suffix for name, suffix in suffixes.items() if suffix in chosen}


@dataclass(frozen=True)
class ScanFolder:
    """Folder that contains scans."""

    path: Path
    suffixes: Mapping[str, str]  # Suffix of each scan, by the name of its file

    @cached_property
    def layout(self) -> Layout | None:
        """The layout of a data set that the folder fits."""
        return layout_of(self.path, self.suffixes)

    @property
    def rank(self) -> int:
        """How certain it is that the files are scans."""
        suffixes = {*self.suffixes.values()}
        if self.layout or not all(map(is_table, suffixes)):
            return CERTAIN
        return UNLIKELY if suffixes <= {*TEXT_SUFFIXES} else LIKELY


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderSearch:
    """Result of a search below a folder."""

    folders: list[ScanFolder] = field(default_factory=list)  # Sorted by path
    recordings: list[Path] = field(default_factory=list)
    # Names of files with points that are not read, by folder
    unread: dict[Path, list[str]] = field(default_factory=dict)
    # Number of files and folders after which the search stopped; 0 if it looked at all
    stopped_after: int = 0


def search_below(
    root: Path, most: int = MAX_ENTRIES, *, skipped: Collection[Path] = ()
) -> FolderSearch:
    """Search the folders below a root, not itself, for scans.

    Hidden folders, folders of labels, recordings, results of stages and folders below scans are
    not searched, and no folder twice, whatever links lead to it.

    Parameters
    ----------
    root : Path
        Folder, searched to a depth of `MAX_DEPTH`.
    most : int
        Number of files and folders that the search looks at before it stops.
    skipped : collection of Path
        Folders that are not searched.

    Returns
    -------
    FolderSearch
    """
    search = FolderSearch()
    waiting = deque((path, 1) for path in _subfolders(root, is_root=True))
    visited = {_inode(root), *map(_inode, skipped)}
    entries = 0
    while waiting:
        path, depth = waiting.popleft()
        try:
            inode = _inode(path)
            if inode in visited:
                continue
            visited.add(inode)
            if is_recording(path):
                search.recordings.append(path)
                continue
            names = names_in(path)
            subfolders = _subfolders(path)
        except (OSError, FormatError):
            continue  # A folder that may not be read
        entries += len(names) + len(subfolders)
        if entries > most:
            search = replace(search, stopped_after=most)
            break
        folder = ScanFolder(path, scan_names(names))
        if folder.suffixes:
            search.folders.append(folder)
        search.recordings.extend(path / n for n in names if n.lower().endswith(RECORDING_SUFFIXES))
        if unread := sorted(name for name in names if name.lower().endswith(UNREAD_SUFFIXES)):
            search.unread[path] = unread
        if depth < MAX_DEPTH and not (folder.suffixes and folder.rank == CERTAIN):
            waiting.extend((subfolder, depth + 1) for subfolder in subfolders)
    search.folders.sort(key=attrgetter("path"))
    search.recordings.sort()
    return search


def _inode(folder: Path) -> tuple[int, int]:
    """Return what identifies a folder, whatever path leads to it."""
    status = folder.stat()
    return status.st_dev, status.st_ino


def _subfolders(folder: Path, *, is_root: bool = False) -> list[Path]:
    """Return the folders in a folder that may contain scans.

    Results may have been written into the root of the scans, or into a folder below it.
    """
    sequences = folder / "sequences"
    others = [folder / name for name in folders_in(folder) if name != LABEL_FOLDER]
    if folder.name == TOOL_FOLDER and present(folder.parent / PICK_RECORD):
        # Copies of the picked scans
        others = [other for other in others if other.name not in TOOLS]
    if not is_folder(folder / FILE_LISTS):
        return others
    # Results of stages are no scans, but `convert`, `filter` and `synth` write data sets.
    names = folders_in(sequences) if is_folder(sequences) else []
    places = [sequences / name / SCAN_FOLDER for name in names]
    data_sets = [folder for folder in places if is_folder(folder)]
    if not is_root:
        return data_sets
    return [other for other in others if other != sequences] + data_sets


def usable(folders: Collection[ScanFolder]) -> list[ScanFolder]:
    """Return the folders of the scans; none if several could be meant.

    These are all folders of the only known layout, else the only folder of scans.
    """
    layout_folders = [folder for folder in folders if folder.layout]
    if layout_folders:
        is_one = len({folder.layout.name for folder in layout_folders if folder.layout}) == 1
        return layout_folders if is_one else []
    ranked = [folder for folder in folders if folder.rank > UNLIKELY]
    best = max((folder.rank for folder in ranked), default=UNLIKELY)
    chosen = [folder for folder in ranked if folder.rank == best]
    return chosen if len(chosen) == 1 else []


def words_of_choice(
    source: Path, root: Path, chosen: Collection[ScanFolder], folders: Collection[ScanFolder]
) -> str:
    """Return the line about the folders that are used, and those that are not.

    `source` is the folder as the user gave it, `root` its absolute path.
    """
    layout = next(iter(chosen)).layout
    used = first_few([_counted(folder, root) for folder in chosen])
    kind = f" in the layout of {layout.name}" if layout else ""
    others = [folder for folder in folders if folder not in chosen and folder.rank > UNLIKELY]
    unused = first_few([_counted(folder, root) for folder in others])
    text = f"{source}: contains no scans itself; using {used}{kind}"
    return f"{text}; not used: {unused}" if unused else text


def words_of_others(
    source: Path, root: Path, others: Collection[ScanFolder], stopped_after: int
) -> str:
    """Return the line about folders of scans that are not used; empty if there is none to name.

    `source` is the folder as the user gave it, `root` its absolute path.
    """
    words = []
    if others:
        listed = first_few([_counted(folder, root) for folder in others])
        words = [f"not used: {listed}", _commands(source, root, others)]
    if stopped_after:
        words.append(f"the search for other scans stopped after {stopped_after:,} files")
    return f"{source}: {'; '.join(words)}" if words else ""


def words_of_drives(source: Path, root: Path, drives: Collection[ScanFolder]) -> str:
    """Return the line about deeper folders of drives that are used too."""
    return f"{source}: also using {first_few([_counted(folder, root) for folder in drives])}"


def ambiguous_folders(
    source: Path, root: Path, search: FolderSearch, tables: ScanFolder | None = None
) -> NoInputError:
    """Return the error of a folder below which several may contain the scans, or more may be.

    `source` is the folder as the user gave it, `root` its absolute path, and `tables` the tables
    in it.
    """
    best = max(folder.rank for folder in search.folders)
    likely = [folder for folder in search.folders if folder.rank == best]
    listed = first_few([_counted(folder, root) for folder in likely])
    problem = f"contains no scans itself, but there are some below it: {listed}"
    if tables:
        problem = f"may contain scans itself, {_counted(tables, root)}, or below it: {listed}"
    if search.stopped_after:
        problem = f"{problem}; the search stopped after {search.stopped_after:,} files"
    hint = _commands(source, root, [tables, *likely] if tables else likely)
    return NoInputError(source, problem, "one folder of scans", hint)


def folders_of_one_name(
    source: Path, root: Path, name: str, folders: Collection[ScanFolder]
) -> NoInputError:
    """Return the error of several folders with scans of one sequence."""
    listed = first_few([_counted(folder, root) for folder in folders])
    problem = f"contains several folders with scans of sequence {name}: {listed}"
    return NoInputError(source, problem, "one of each name", _commands(source, root, folders))


def _commands(source: Path, root: Path, folders: Iterable[ScanFolder]) -> str:
    """Return the command for each of the first folders, for the files in the root itself."""
    words = []
    for folder in folders:
        word = shlex.quote(str(source / folder.path.relative_to(root)))
        if folder.path == root:
            word = f"{word}/*{min(folder.suffixes.values())}"
        words.append(f"salsanext predict {word} out")
    return f"give one as SCANS: {'; or '.join(words[:MAX_LISTED_NAMES])}"


def other_files_below(source: Path, search: FolderSearch) -> NoInputError | None:
    """Return the error of a folder with recordings or unread files below it; None without any."""
    if search.recordings:
        problem = f"contains no scans, but recordings below it: {first_few(search.recordings)}"
        hint = f"give one recording, such as {search.recordings[0]}"
        return NoInputError(source, problem, "scans", hint)
    if search.stopped_after and not search.unread:
        problem = f"contains no scans itself, and over {search.stopped_after:,} files below it"
        return NoInputError(source, problem, "a folder of scans", "give the folder of the scans")
    if search.unread:
        folder = min(search.unread)
        names = search.unread[folder]
        kind = unread_kind(names[0])
        problem = f"contains no scans, but {kind} files below it, in {folder}"
        return NoInputError(source, problem, "scans", folder_hint(folder, names))
    return None


def _counted(folder: ScanFolder, root: Path) -> str:
    """Return a folder, relative to a root, and the number of its scans by suffix."""
    counts = sorted(Counter(folder.suffixes.values()).items())
    text = ", ".join(f"{count} {suffix}" for suffix, count in counts)
    return f"{folder.path.relative_to(root)} ({text})"


def hint_of_labels(folder: Path, names: Iterable[str]) -> str:
    """Return the hint for files of labels in a folder, to give that of their scans; else ""."""
    if not any(name.endswith(LABEL_SUFFIX) for name in names):
        return ""
    scans = Path(os.path.normpath(folder / os.pardir / SCAN_FOLDER))
    place = shlex.quote(str(scans)) if scans.is_dir() else "the folder of the scans"
    return f"labels are no scans: give {place}"


def counted_by_suffix(paths: Iterable[Path]) -> str:
    """Return the numbers of files by suffix, in words."""
    counts = sorted(Counter(path.suffix.lower() for path in paths).items())
    return ", ".join(f"{count} {suffix or 'without a suffix'}" for suffix, count in counts)


def unread_file_error(path: Path) -> NoInputError:
    """Return the error of a file that is neither a scan nor a recording."""
    problem = f"{path.suffix} files are not supported" if path.suffix else "has no suffix"
    if unread_kind(path.name) == UNFINISHED:
        problem = "is a bag that was never closed"
    hint = hint_of_labels(path.parent, [path.name]) or conversion_hint(path)
    return NoInputError(path, problem, f"one of {suffixes_in_words()}", hint)


def no_scans_error(source: Path, others: list[str]) -> NoInputError:
    """Return the error of a source without scans, with the names of the files in it."""
    expected = f"{suffixes_in_words()} files, or sequences/*/velodyne"
    inside = sorted(filter(is_recording, source.iterdir())) if source.is_dir() else []
    if inside:
        problem = f"contains no scans, but recordings: {first_few([r.name for r in inside])}"
        return NoInputError(source, problem, expected, f"give one recording, such as {inside[0]}")
    paths = [source / name for name in others]
    problem = f"contains no scans{f', but {counted_by_suffix(paths)}' if paths else ''}"
    hint = hint_of_labels(source, others) or folder_hint(source, others)
    return NoInputError(source, problem, f"{expected}, or a recording", hint)
