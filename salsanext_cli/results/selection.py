# SPDX-License-Identifier: MIT
"""Selection of the scans that a stage works on, and their label space."""

import logging
import os
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, label_space
from salsanext_cli.classes.merging import ClassMerging, is_merged
from salsanext_cli.errors import NOTICE, NoInputError, UsageError, counted, first_few, warn_once
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats.recordings import recording_of
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.results.paths import (
    SCAN_FOLDER,
    ScanFile,
    counted_by_suffix,
    find_scans,
    of_sequences,
    require_unique_stems,
)

LABEL_SPACE_FILES = ("labels.yaml", "semantic-kitti.yaml")
"""Names, in the root of a data set, of the file that describes its label space."""
COMPANIONS = (".label", ".toml", ".yaml", ".md")  # Suffixes of files beside scans

log = logging.getLogger(__name__)
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class MissingResults:
    """Scans without results."""

    # Those that a stage was asked for: it failed, was interrupted, or its results were deleted.
    # All, where no stage recorded what it was asked for
    scans: tuple[ScanFile, ...] = ()
    not_asked_for: int = 0  # Number of the others, which were left out on purpose

    def log_error(self, count: int, what: str) -> None:
        """Log how many of so many scans lack what they should have."""
        if self.scans:
            message = "%d of %d scans have no %s and are left out, the first is %s"
            log.error(message, len(self.scans), count, what, self.scans[0].name)

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        missing = [str(scan.path) for scan in self.scans]
        return {"missing": missing, "not_asked_for": self.not_asked_for}


def scans_of(source: Path | Sequence[Path]) -> list[ScanFile]:
    """Find all scans of a source or several, as `layout.find_scans`; log what lies beside them."""
    if not isinstance(source, Path):
        several = sorted({scan for each in source for scan in scans_of(each)})
        require_unique_stems(several)
        return several
    scans = find_scans(source)
    if is_folder(source) and recording_of(scans[0].path) is None:
        folders = {path.parent for path in {scan.sequence: scan.path for scan in scans}.values()}
        _log_passed_over(source, sorted(folders), {scan.path.name for scan in scans})
    return scans


def _log_passed_over(source: Path, folders: Iterable[Path], scans: Collection[str]) -> None:
    """Log how many files beside scans of some names are passed over."""
    left = []
    for folder in folders:
        with os.scandir(folder) as entries:
            # Of a million names nearly all are those of scans and their labels.
            others = [e for e in entries if e.name not in scans and not e.name.startswith(".")]
            others = [e for e in others if not e.name.lower().endswith(COMPANIONS)]
            left += [folder / e.name for e in others if not is_folder(e)]
    if left:
        log.log(NOTICE, "%s: passed over %s", source, counted_by_suffix(left))


def select_scans(
    source: Path, selection: ScanSelection, space: LabelSpace | None = None, *, evenly: bool = False
) -> list[ScanFile]:
    """Find the scans of a source and choose among them, those of a limit `evenly` or the first.

    `space`: of a source that has none of its own.
    """
    scans = scans_of(source)
    unlimited = replace(selection, limit=None) if evenly else selection
    scans = choose(scans, unlimited, space_of(scans, space), source)
    return evenly_spaced(scans, selection.limit or 0) if evenly else scans


def choose(
    scans: list[ScanFile], selection: ScanSelection, space: LabelSpace, source: object
) -> list[ScanFile]:
    """Choose scans by sequences, split and limit; all, with a warning, if no split names any."""
    if selection.sequences:
        scans = of_sequences(scans, selection.sequences, source)
    if selection.split is not None:
        space = with_splits(space, data_set_of(scans[0]) if scans else None)
        members = space.split(selection.split)
        sequences = sorted({scan.sequence for scan in scans})
        if not {*members}.isdisjoint(sequences):
            chosen = [scan for scan in scans if scan.sequence in members]
            if None in map(space.split_of, sequences):
                log_unused(scans, chosen, space, "choose with --sequences")
            scans = chosen
        elif any(map(space.split_of, sequences)):
            named = ", ".join(members) or "no sequences"
            found, expected = f"no scans of split {selection.split} ({named})", ", ".join(sequences)
            hint = "choose with --split or --sequences"
            raise NoInputError(source, found, f"some besides {expected}", hint)
        else:
            log.warning("no split names %s: taking all", ", ".join(sequences))
    return scans[: selection.limit]


def log_unused(
    scans: Sequence[ScanFile], used: Collection[ScanFile], space: LabelSpace, hint: str
) -> None:
    """Log in one line how many scans are used, which sequences are not, and what changes that."""
    sequences = sorted({scan.sequence for scan in scans} - {scan.sequence for scan in used})
    by_split: dict[str, list[str]] = {}
    for sequence in sequences:
        split = space.split_of(sequence)
        by_split.setdefault(f"split {split}" if split else "no split", []).append(sequence)
    if by_split:
        unused = ", ".join(f"{first_few(names)} ({why})" for why, names in by_split.items())
        every = counted(len(scans), "scan")
        log.warning("%d of %s used; not used: %s; %s", len(used), every, unused, hint)


def data_set_of(scan: ScanFile) -> Path | None:
    """Return the root of the data set that a scan lies in, None for a folder of one's own."""
    folder = scan.path.parent
    inside = folder.name == SCAN_FOLDER and folder.parent.parent.name == "sequences"
    return folder.parents[2] if inside else None


def data_set_label_space(root: Path) -> LabelSpace | None:
    """Return the label space that a data set describes in its root, None if it does not."""
    for name in LABEL_SPACE_FILES:
        if present(root / name):
            return label_space(root / name)
    return None


def with_splits(
    space: LabelSpace, root: Path | None = None, *, alternatives: bool = False
) -> LabelSpace:
    """Return a label space with splits: its own, else the data set's, else SemanticKITTI's.

    `alternatives`: whether it gets the data set's alternatives of merged classes too.
    """
    own = None
    try:
        if root and (alternatives or not space.splits):
            own = data_set_label_space(root)
    except UsageError as error:
        if not space.splits:
            raise
        warn_once(log, f"{error}: label space {space.name} is taken without it")
    if alternatives and own is not None and is_merged(space, own):
        space = ClassMerging.between(own, space).space
    if space.splits:
        return space
    return replace(space, splits=(own and own.splits) or label_space().splits)


def space_of(scans: Sequence[ScanFile], fallback: LabelSpace | None = None) -> LabelSpace:
    """Return the label space of the scans' data set, else SemanticKITTI's or one that differs."""
    root = data_set_of(scans[0]) if scans else None
    if root and (own := data_set_label_space(root)):
        return own
    usual = label_space()
    return usual if fallback is None or fallback.fits(usual) else fallback


def evenly_spaced(files: Sequence[Item], count: int) -> list[Item]:
    """Return `count` of the files, evenly spaced; all if `count` is 0 or there are no more."""
    if count == 0 or count >= len(files):
        return list(files)
    return [files[i] for i in np.linspace(0, len(files) - 1, count).round().astype(int)]


def space_of_labels(
    scans: Sequence[ScanFile], space: LabelSpace, labels: LabelSpace | None = None
) -> LabelSpace:
    """Return the meaning of the raw ids of labels, or of those of the same names as the space."""
    own = labels or space_of(scans, space)
    return own if own.names == space.names else space
