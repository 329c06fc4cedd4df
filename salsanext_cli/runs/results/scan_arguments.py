# SPDX-License-Identifier: MIT
"""Arguments with which a command works on the scans that earlier runs were asked for."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import identity, is_folder, reachable
from salsanext_cli.io.formats.recordings import reachable_recording
from salsanext_cli.runs.results.manifest import RESULT_STAGES, Manifest, ScanSource
from salsanext_cli.runs.results.scan_places import folders_now
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_folders import folders_in
from salsanext_cli.runs.scans.scan_search import find_scans, scans_at_top
from salsanext_cli.runs.scans.selection import data_set_of

UNKNOWN_SCANS = "SCANS"
"""Word for scans that are not known, or that no short command names."""
MAX_NAMED_SOURCES = 3
"""Files or folders that a command names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanArguments:
    """Arguments that name scans."""

    sources: tuple[str, ...] = (UNKNOWN_SCANS,)
    sequences: tuple[str, ...] = ()  # All of the sources if empty
    limit: int | None = None  # Number of the first scans, all if None

    def settings(self) -> list[str]:
        """Return the settings that choose the scans in the sources, as `setting` spells them."""
        settings: list[str] = []
        if self.sequences:
            settings.append(setting("sequences", ",".join(self.sequences)))
        if self.limit is not None:
            settings.append(setting("limit", self.limit))
        return settings


UNKNOWN = ScanArguments()


def scan_arguments(out: Path, scans: Sequence[ScanFile]) -> ScanArguments:
    """Name the scans that the runs in a folder were asked for and that are there.

    Parameters
    ----------
    out : Path
        Folder with results.
    scans : sequence of ScanFile
        Scans that need results, where they are now. If no recorded run was asked for any of them,
        the data set or the folder of the first one is named.

    Returns
    -------
    ScanArguments
    """
    if not scans:
        return UNKNOWN
    folders = folders_now(Manifest(out), scans)
    paths = [*map(Manifest(out).path, RESULT_STAGES), *map(Path, sorted({*folders.values()}))]
    state = tuple(map(identity, paths))
    recorded = _asked_for(out.absolute(), tuple(sorted(folders.items())), state)
    if recorded.scans.isdisjoint(scans):
        return _whole(scans[0])
    return recorded.arguments


@dataclass(frozen=True, slots=True, kw_only=True)
class _AskedFor:
    """Scans that runs were asked for, and the arguments that name them."""

    scans: frozenset[ScanFile]
    arguments: ScanArguments


@lru_cache(8)  # Every failing scan of a run has the same hint.
def _asked_for(out: Path, folders: tuple[tuple[str, str], ...], _: tuple[object, ...]) -> _AskedFor:
    """Return the scans that runs were asked for; the last argument changes with their files.

    `folders`: present folder of each recorded one.
    """
    sources_by_folder: dict[str, dict[str, ScanSource]] = {}
    now = dict(folders)
    for sequence, source in Manifest(out).sources().items():
        if source.folder in now:
            sources_by_folder.setdefault(now[source.folder], {})[sequence] = source
    present_scans: list[ScanFile] = []
    scans: list[ScanFile] = []
    for folder, sources in sources_by_folder.items():
        in_folder = _scans_in(Path(folder))
        present_scans += in_folder
        scans += _scans_of_sources(Path(folder), in_folder, sources)
    arguments = _arguments(sorted(scans), sorted(present_scans))
    return _AskedFor(scans=frozenset(scans), arguments=arguments)


def _scans_in(folder: Path) -> list[ScanFile]:
    """Return the scans in a folder, none if it is gone or cannot be read."""
    try:
        return scans_at_top(folder)
    except (NoInputError, FormatError):
        return []


def _scans_of_sources(
    folder: Path, in_folder: Collection[ScanFile], sources: Mapping[str, ScanSource]
) -> list[ScanFile]:
    """Return the scans of recorded sources, by sequence, that are in their folder."""
    scans: list[ScanFile] = []
    for scan in in_folder:
        source = sources.get(scan.sequence)
        suffix = source.suffixes.get(scan.stem) if source else None
        # Scans of recordings, and those in older records, have no suffix.
        if suffix is not None and (not suffix or scan.path.name == scan.stem + suffix):
            scans.append(scan)
    # Tables beside clouds are scans only if they were named.
    listed = {scan.path for scan in in_folder}
    for sequence, source in sources.items():
        for stem, suffix in source.suffixes.items():
            path = folder / f"{stem}{suffix}"
            if suffix and path not in listed and reachable(path):
                scans.append(ScanFile(sequence=sequence, stem=stem, path=path))
    return scans


def _arguments(scans: list[ScanFile], in_folders: list[ScanFile]) -> ScanArguments:
    """Return the arguments of sorted scans, whose folders contain these sorted scans."""
    sequences = {scan.sequence for scan in scans}
    candidates = [scan for scan in in_folders if scan.sequence in sequences]
    count = len(scans)
    if not scans:
        return UNKNOWN
    if scans == candidates:
        return _folders_of(scans, in_folders)
    paths = [scan.path for scan in scans]
    if count <= MAX_NAMED_SOURCES and not any(map(reachable_recording, paths)):
        return ScanArguments(sources=tuple(map(str, paths)))
    if scans == candidates[:count]:
        arguments = _folders_of(candidates, in_folders)
        return replace(arguments, limit=None if arguments == UNKNOWN else count)
    return UNKNOWN


def _folders_of(scans: Collection[ScanFile], in_folders: Collection[ScanFile]) -> ScanArguments:
    """Return the arguments of all scans of some sequences in folders with these scans."""
    scan_by_folder = {scan.path.parent: scan for scan in scans}
    folders = sorted(scan_by_folder)
    data_set, *other_data_sets = {*map(data_set_of, scan_by_folder.values())}
    has_others = len(scans) < len(in_folders)
    if len(folders) > 1 and data_set is not None and not other_data_sets:
        sources = [data_set]
        has_others = has_others or _has_others(data_set, folders)
    elif len(folders) <= MAX_NAMED_SOURCES:
        sources = folders
    else:
        return UNKNOWN
    sequences = sorted({scan.sequence for scan in scans}) if has_others else []
    return ScanArguments(sources=tuple(map(str, sources)), sequences=tuple(sequences))


def _has_others(data_set: Path, folders: Collection[Path]) -> bool:
    """Return whether a data set has, or may have, further folders of scans."""
    sequences = data_set / "sequences"
    if not is_folder(sequences):
        return True
    scan_folders = {sequences / name / SCAN_FOLDER for name in folders_in(sequences)}
    return any(map(is_folder, scan_folders - {*folders}))


def _whole(file: ScanFile) -> ScanArguments:
    """Return the arguments of all scans of the data set or the folder of a scan."""
    with suppress(NoInputError, FormatError):
        # A sequence that was renamed has another name in a run over its folder.
        if reachable_recording(file.path) or file in find_scans(file.path, unique=False):
            return ScanArguments(sources=(str(data_set_of(file) or file.path.parent),))
    return UNKNOWN
