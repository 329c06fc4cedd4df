# SPDX-License-Identifier: MIT
"""The owner of an output folder, in which several stages leave results of the same scans."""

import io
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.classes.label_space import RawIds
from salsanext_cli.errors import OutputError, shortened
from salsanext_cli.files.reading import filled
from salsanext_cli.formats.kitti import encode_labels
from salsanext_cli.results.manifest import (
    MAX_PATH_CHARACTERS,
    Manifest,
    ScanSource,
    StageRecord,
    merged_sources,
    require_same_settings,
    settings_json,
)
from salsanext_cli.results.owned_folder import OwnedFolder, not_own
from salsanext_cli.results.paths import DISAGREEMENT, ERROR, ScanFile, find_outputs, output_path
from salsanext_cli.results.settings import StageSettings


@dataclass(frozen=True, slots=True)
class OutputRun(OwnedFolder):
    """One run of a stage in an output folder, which others with the same settings may share."""

    # Folders of results that a scan is given, keys of `SUFFIX_OF_FOLDER`
    folders: tuple[str, ...] = ()
    overwrite: bool = False  # Whether results that are there are made again
    # Results that are not as salsanext wrote them, of scans that lack a result or have one of other
    # settings: they are never replaced
    kept: frozenset[Path] = frozenset()

    def path(self, file: ScanFile, folder: str) -> Path:
        """Return where a result of a scan lies."""
        return output_path(self.root, file.sequence, folder, file.stem)

    def paths(self, file: ScanFile) -> list[Path]:
        """Return where all results of a scan lie."""
        return [self.path(file, folder) for folder in self.folders]

    def is_there(self, file: ScanFile) -> bool:
        """Say whether a scan has all its results."""
        return all(filled(path) and path not in self.kept for path in self.paths(file))

    def is_done(self, file: ScanFile) -> bool:
        """Say whether a scan has all its results, and they are not to be made again."""
        return not self.overwrite and self.is_there(file)

    def require_replaceable(self, file: ScanFile) -> None:
        """Refuse to replace a result of a scan that is not as salsanext wrote it."""
        for path in self.kept.intersection(self.paths(file)):
            raise not_own(path)

    def write_array(self, file: ScanFile, folder: str, array: npt.NDArray[Any]) -> None:
        """Write a result of a scan as a `.npy` file."""
        self.write(self.path(file, folder), encode_array(array))

    def write_labels(self, file: ScanFile, raw: RawIds) -> None:
        """Write the predicted raw ids of a scan's points, (N,) integer."""
        self.write(self.path(file, "predictions"), encode_labels(raw))

    def claim(self, wanted: StageRecord) -> StageRecord:
        """Bring the records, which are locked, and the results to what the run wants, or refuse."""
        known = self.manifest.records()
        before = known.pop(self.stage, None) or StageRecord(self.stage, wanted.settings)
        same = before.has_settings(wanted.settings)
        others = [each for each in known.values() if {*each.writes} & {*wanted.writes}]
        if "predictions" in wanted.writes and not same and "fuse" in known:
            others.append(known["fuse"])
        if not self.overwrite:
            require_same_settings(self.record_path, before.settings, wanted.settings)
            for other in others:
                folder = next(name for name in wanted.writes if name in other.writes)
                found = f"{folder}/ holds the results of `{other.stage}`"
                hint = "use another output folder, or --overwrite to replace them"
                raise OutputError(self.manifest.path(other.stage), found, hint=hint)
        # Nothing is removed before it is certain that the run may begin, but locks of killed runs.
        for each in (before, *others):
            of_stage = OwnedFolder(self.root, each.stage)
            if of_stage.is_shared() and not (same and each is before):
                raise of_stage.busy()
        kept = [] if same else self.remove_own(self._results_in(before.writes))
        for other in others:
            kept += self._take_over(other, wanted.writes)
        taken = {folder for each in (before, *others) for folder in each.writes}
        kept += self._remove_unrecorded(name for name in wanted.writes if name not in taken)
        names = {path.relative_to(self.root).as_posix() for path in kept}
        merged = replace(wanted, kept=tuple(sorted(names)))
        if same:
            merged = replace(
                merged,
                settings=before.settings,
                writes=tuple(sorted({*before.writes, *wanted.writes})),
                scans=merged_sources((before.scans, wanted.scans)),
                kept=tuple(sorted({*before.kept, *names})),
            )
        # The record comes last: without it, a run that was killed before begins anew.
        self.manifest.write(merged)
        return merged

    def _take_over(self, other: StageRecord, folders: Collection[str]) -> list[Path]:
        """Remove the results of another stage from folders, and what is known of its labels."""
        taken = {*folders, ERROR, DISAGREEMENT, "views"} if "predictions" in folders else {*folders}
        kept = self.remove_own(self._results_in(each for each in other.writes if each in taken))
        left = tuple(name for name in other.writes if name not in taken)
        self.manifest.write(replace(other, writes=left))
        return kept

    def _remove_unrecorded(self, folders: Iterable[str]) -> list[Path]:
        """Refuse results that no stage recorded, or remove them: their settings are not known."""
        results = self._results_in(folders)
        if results and not self.overwrite:
            hint = "use another output folder, or --overwrite to work beside it"
            raise OutputError(results[0], "is a result that no stage recorded", hint=hint)
        return self.remove_own(results)

    def _results_in(self, folders: Iterable[str]) -> list[Path]:
        return [path for name in folders for path in find_outputs(self.root, name).values()]


def encode_array(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    array = np.ascontiguousarray(array)
    with io.BytesIO() as file:
        npy.write_array(file, array, version=(1, 0), allow_pickle=False)
        return file.getvalue()


def _scan_sources(out: Path, scans: Iterable[ScanFile]) -> dict[str, ScanSource]:
    """Return where scans lie, and their files, by sequence; refuse others than recorded ones."""
    known, suffixes = Manifest(out).sources(), dict[str, dict[str, str]]()
    folders = dict[str, str]()
    for scan in scans:
        suffix = scan.path.name[len(scan.stem) :]
        folder = folders.setdefault(scan.sequence, str(scan.path.parent))
        recorded = known.get(scan.sequence, ScanSource(folder, {}))
        other = scan.stem + (recorded.suffixes.get(scan.stem) or suffix)
        if recorded.folder != str(scan.path.parent) or other != scan.path.name:
            came_from = shortened(str(Path(recorded.folder, other)), MAX_PATH_CHARACTERS)
            found = f"results of sequence {scan.sequence} came from {came_from}"
            raise OutputError(
                out, found, f"that file, not {scan.path}", "use another output folder"
            )
        suffixes.setdefault(scan.sequence, {})[scan.stem] = suffix
    return {name: ScanSource(folders[name], suffixes[name]) for name in folders}


@contextmanager
def output_run(
    out: Path,
    stage: str,
    settings: StageSettings,
    folders: Iterable[str],
    scans: Sequence[ScanFile],
    *,
    overwrite: bool,
    record_scans: bool = True,
) -> Iterator[OutputRun]:
    """Record what a stage does in `OUT/<stage>.json`, or refuse to mix it with other results.

    Runs with the same settings may work beside it, and none with others may remove its results.
    `record_scans`: not for a stage that works on what an earlier one recorded.
    """
    # A contradiction of the scans themselves is an error before a folder is made.
    sources = _scan_sources(out, scans) if record_scans else {}
    run = OutputRun(out, stage, folders=tuple(folders), overwrite=overwrite)
    wanted = StageRecord(stage, settings_json(settings), tuple(sorted(run.folders)), sources)
    with ExitStack() as stack:
        with run.locked_records():
            recorded = run.claim(wanted)
            stack.enter_context(run.open(shared=True))
        # First those of other settings: they are no results of this run.
        run = replace(run, kept=frozenset(run.foreign_files(out / name for name in recorded.kept)))
        todo = [path for file in scans if not run.is_done(file) for path in run.paths(file)]
        yield replace(run, kept=frozenset(run.foreign_files(todo)))
        record = run.manifest.record(stage)
        if record is None or not record.has_settings(wanted.settings):
            found = "was removed or replaced while results were written into it"
            raise OutputError(out, found, hint="run again with --overwrite")
