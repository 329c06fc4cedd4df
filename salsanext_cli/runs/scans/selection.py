# SPDX-License-Identifier: MIT
"""Selection of the scans that a stage works on, and their label space."""

import logging
import os
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging, is_merged
from salsanext_cli.core.errors import NoInputError, UsageError
from salsanext_cli.core.notices import NOTICE, warn_once
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import is_folder, present
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER, layout_of
from salsanext_cli.runs.scans.scan_file import ScanFile, require_unique_stems
from salsanext_cli.runs.scans.scan_folders import counted_by_suffix
from salsanext_cli.runs.scans.scan_search import find_scans, scans_of_sequences
from salsanext_cli.runs.scans.scan_selection import ScanSelection

LABEL_SPACE_FILES = ("labels.yaml", "semantic-kitti.yaml")
"""Names, in the root of a data set, of the file that describes its label space."""
COMPANIONS = (".label", ".toml", ".yaml", ".md")  # Suffixes of files beside scans

log = logging.getLogger(__name__)
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingResults:
    """Scans without results."""

    # Scans that a stage was asked for: it failed, was interrupted, or its results were deleted.
    # All scans, if no stage recorded what it was asked for
    scans: tuple[ScanFile, ...] = ()
    not_asked_for: int = 0  # Number of the other scans

    def log_error(self, count: int, results: str) -> None:
        """Log how many of `count` scans have no results of a kind."""
        if self.scans:
            message = "%d of %d scans skipped, without %s; the first is %s"
            log.error(message, len(self.scans), count, results, self.scans[0].name)

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        missing = [str(scan.path) for scan in self.scans]
        return {"missing": missing, "not_asked_for": self.not_asked_for}


def scans_of(source: Path | Sequence[Path]) -> list[ScanFile]:
    """Find all scans of one or several sources (see `find_scans`); log skipped files."""
    if not isinstance(source, Path):
        scans = sorted({scan for path in source for scan in scans_of(path)})
        require_unique_stems(scans)
        return scans
    scans = find_scans(source)
    if is_folder(source) and recording_of(scans[0].path) is None:
        path_of_sequence = {scan.sequence: scan.path for scan in scans}
        folders = sorted({path.parent for path in path_of_sequence.values()})
        _log_skipped(source, folders, {scan.path.name for scan in scans})
    return scans


def _log_skipped(source: Path, folders: Iterable[Path], scans: Collection[str]) -> None:
    """Log the number of files in folders of scans that are neither scans nor companions."""
    skipped = []
    for folder in folders:
        with os.scandir(folder) as entries:
            # The cheap conditions come first: there may be a million scans.
            others = [e for e in entries if e.name not in scans and not e.name.startswith(".")]
            others = [e for e in others if not e.name.lower().endswith(COMPANIONS)]
            skipped += [folder / e.name for e in others if not is_folder(e)]
    if skipped:
        log.log(NOTICE, "%s: skipped %s", source, counted_by_suffix(skipped))


def select_scans(
    source: Path, selection: ScanSelection, space: LabelSpace | None = None, *, evenly: bool = False
) -> list[ScanFile]:
    """Find and select the scans of a source; a limit takes the first scans or spreads `evenly`.

    `space`: label space of a source that does not describe one.
    """
    scans = scans_of(source)
    unlimited = replace(selection, limit=None) if evenly else selection
    scans = choose(scans, unlimited, space_of(scans, space), source)
    return evenly_spaced(scans, selection.limit or 0) if evenly else scans


def choose(
    scans: list[ScanFile], selection: ScanSelection, space: LabelSpace, source: object
) -> list[ScanFile]:
    """Select scans by sequences, split and limit; all, with a warning, if no split names any."""
    if selection.sequences:
        scans = scans_of_sequences(scans, selection.sequences, source)
    if selection.split is not None:
        space = with_splits(space, data_set_of(scans[0]) if scans else None)
        members = space.split(selection.split)
        sequences = sorted({scan.sequence for scan in scans})
        if not {*members}.isdisjoint(sequences):
            chosen = [scan for scan in scans if scan.sequence in members]
            if None in map(space.split_of, sequences):
                log_unused(scans, chosen, space, f"choose with {argument('sequences')}")
            scans = chosen
        elif any(map(space.split_of, sequences)):
            split = f"split {selection.split} ({', '.join(members) or 'no sequences'})"
            problem = f"has no scans of {split}, only {', '.join(sequences)}"
            hint = f"choose with {argument('split')} or {argument('sequences')}"
            raise NoInputError(source, problem, hint=hint)
        else:
            log.warning("no split names %s: using all scans", ", ".join(sequences))
    return scans[: selection.limit]


def log_unused(
    scans: Sequence[ScanFile], used: Collection[ScanFile], space: LabelSpace, hint: str
) -> None:
    """Log how many scans are used and which sequences are not, with a hint."""
    sequences = sorted({scan.sequence for scan in scans} - {scan.sequence for scan in used})
    by_split: dict[str, list[str]] = {}
    for sequence in sequences:
        split = space.split_of(sequence)
        by_split.setdefault(f"split {split}" if split else "no split", []).append(sequence)
    if by_split:
        unused = ", ".join(f"{first_few(names)} ({why})" for why, names in by_split.items())
        total = counted(len(scans), "scan")
        log.warning("%s", with_hint(f"{len(used)} of {total} used; not used: {unused}", hint))


def data_set_of(scan: ScanFile) -> Path | None:
    """Return the root of the data set of a scan, None for a scan in a plain folder."""
    folder = scan.path.parent
    if folder.name == SCAN_FOLDER and folder.parent.parent.name == "sequences":
        return folder.parents[2]
    layout = layout_of(folder, [scan.path.name])
    return layout.root(folder) if layout and layout.has_labels else None


def data_set_label_space(root: Path) -> LabelSpace | None:
    """Return the label space in the root of a data set, None without one."""
    for name in LABEL_SPACE_FILES:
        if present(root / name):
            return label_space(root / name)
    return None


def with_splits(
    space: LabelSpace, root: Path | None = None, *, alternatives: bool = False
) -> LabelSpace:
    """Return a label space with its splits, else those of the data set, else SemanticKITTI's.

    `alternatives`: whether to add the alternatives of merged classes of the data set.
    """
    described = None
    try:
        if root and (alternatives or not space.splits):
            described = data_set_label_space(root)
    except UsageError as error:
        if not space.splits:
            raise
        warn_once(log, f"{error.headline}; using label space {space.name} without it")
    if alternatives and described is not None and is_merged(space, described):
        space = ClassMerging.between(described, space).space
    if space.splits:
        return space
    return replace(space, splits=(described and described.splits) or label_space().splits)


def space_of(scans: Sequence[ScanFile], fallback: LabelSpace | None = None) -> LabelSpace:
    """Return the label space of the scans' data set, else a fallback, else SemanticKITTI's."""
    root = data_set_of(scans[0]) if scans else None
    described = data_set_label_space(root) if root else None
    if described:
        return described
    default = label_space()
    return default if fallback is None or fallback.fits(default) else fallback


def is_of_benchmark(space: LabelSpace) -> bool:
    """Return whether the test split of a label space is that of SemanticKITTI's benchmark."""
    return {*with_splits(space).splits.get("test", ())} == {*label_space().splits["test"]}


def unmerged(space: LabelSpace, scans: Sequence[ScanFile] = ()) -> LabelSpace | None:
    """Return the label space, of the data set or the benchmark, whose classes another merges."""
    finer = [space_of(scans, space), *([label_space()] if is_of_benchmark(space) else [])]
    return next((full for full in finer if is_merged(space, full)), None)


def evenly_spaced(files: Sequence[Item], count: int) -> list[Item]:
    """Return `count` evenly spaced files; all if `count` is 0 or not smaller."""
    if count == 0 or count >= len(files):
        return list(files)
    return [files[i] for i in np.linspace(0, len(files) - 1, count).round().astype(int)]


def space_of_labels(
    scans: Sequence[ScanFile], space: LabelSpace, labels: LabelSpace | None = None
) -> LabelSpace:
    """Return the label space of the labels if its names are the same, else the given one."""
    labels = labels or space_of(scans, space)
    return labels if labels.names == space.names else space
