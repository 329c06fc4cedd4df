# SPDX-License-Identifier: MIT
"""Runs of stages in an output folder, where several stages write results of the same scans."""

import io
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.locks import remove_if_empty
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.runs.records.digest_files import files_of, names_files, with_files
from salsanext_cli.runs.records.stage_settings import StageSettings
from salsanext_cli.runs.results.folder_names import DISAGREEMENT, ERROR
from salsanext_cli.runs.results.manifest import (
    Manifest,
    ScanSource,
    StageRecord,
    merged_sources,
    require_same_settings,
    settings_json,
)
from salsanext_cli.runs.results.output_paths import find_outputs, output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.results.setting_differences import with_new_scales
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, kw_only=True)
class EarlierRecords:
    """Records of a folder that concern a run which begins."""

    stage: StageRecord | None  # Of the same stage
    is_same: bool  # Whether that has the settings of the run; true also without one
    others: Sequence[StageRecord]  # Of stages with results that the run replaces or outdates


@dataclass(frozen=True, slots=True)
class OutputRun(OwnedFolder):
    """One run of a stage in an output folder, shared with other runs of the same settings."""

    folders: tuple[str, ...] = ()  # Folders of results, keys of `SUFFIX_OF_FOLDER`
    overwrite: bool = False  # Whether existing results are computed again
    # Files of the user where results of this run belong (see `owned_folder`)
    foreign: frozenset[Path] = frozenset()

    def path(self, file: ScanFile, folder: str) -> Path:
        """Return the path of a result of a scan."""
        return output_path(self.root, file.sequence, folder, file.stem)

    def paths(self, file: ScanFile) -> list[Path]:
        """Return the paths of all results of a scan."""
        return [self.path(file, folder) for folder in self.folders]

    def has_results(self, sequence: str, stem: str) -> bool:
        """Return whether a scan has all its results."""
        paths = [output_path(self.root, sequence, folder, stem) for folder in self.folders]
        return all(filled(path) and path not in self.foreign for path in paths)

    def names_of_results(self, names: Iterable[str]) -> set[str]:
        """Return the names of scans that have all their results; names of sequences are skipped."""
        complete: set[str] = set()
        for name in names:
            sequence, _, stem = name.rpartition("/")
            if sequence and self.has_results(sequence, stem):
                complete.add(name)
        return complete

    def is_done(self, file: ScanFile) -> bool:
        """Return whether a scan has all its results, which are not to be overwritten."""
        return not self.overwrite and self.has_results(file.sequence, file.stem)

    def require_replaceable(self, file: ScanFile) -> None:
        """Refuse to replace a foreign file by a result of a scan."""
        foreign = self.foreign.intersection(self.paths(file))
        if foreign:
            raise foreign_file(min(foreign))

    def write_array(self, file: ScanFile, folder: str, array: npt.NDArray[Any]) -> None:
        """Write a result of a scan as a `.npy` file."""
        self.write(self.path(file, folder), encode_array(array))

    def write_labels(self, file: ScanFile, raw: RawIds) -> None:
        """Write the predicted raw ids of a scan's points, (N,) integer."""
        self.write(self.path(file, "predictions"), encode_labels(raw))

    def claim(self, new: StageRecord) -> StageRecord:
        """Begin this run in the locked folder: remove outdated results, and record its settings.

        Parameters
        ----------
        new : StageRecord
            Record of this run.

        Returns
        -------
        StageRecord
            Record that was written, which continues the earlier one if the settings are the same.

        Raises
        ------
        OutputError
            If results of other settings or stages must not be replaced, or another run writes
            them.
        """
        earlier = self._earlier_records(new)
        if not self.overwrite:
            self._require_unclaimed(new, earlier)
        self._require_idle(earlier)
        # Nothing is removed before it is certain that the run may begin.
        foreign = self._remove_outdated(new, earlier)
        record = self._continued(new, earlier, foreign)
        # The record comes last, so that the next run repeats what a killed run did not finish.
        self.manifest.write(record)
        return record

    def foresee(self, new: StageRecord) -> StageRecord:
        """Refuse what `claim` refuses because of results; return the record that it continues.

        Nothing is written or locked, so that another run may change the answer.
        """
        earlier = self._earlier_records(new)
        if not self.overwrite:
            self._require_unclaimed(new, earlier)
        recorded = [earlier.stage, *earlier.others] if earlier.stage else [*earlier.others]
        names = {name for record in recorded for name in record.writes}
        self._require_recorded([name for name in new.writes if name not in names])
        return earlier.stage if earlier.stage and earlier.is_same else new

    def withdraw(self) -> None:
        """Remove the record of a run that has ended without any result, and its warnings."""
        with self.locked_records():
            record = self.manifest.record(self.stage)
            if record is None or self.is_shared() or self._results_in(record.writes):
                return
            others = [other for other in self.manifest.records().values() if other != record]
            needed = {name for other in others for name in files_of(other.settings)}
            files = files_of(record.settings) - needed
            self.remove_records([self.record_path.name, self.findings_path.name, *files])

    def _earlier_records(self, new: StageRecord) -> EarlierRecords:
        """Return the records of the folder that concern a run of this stage."""
        records = self.manifest.records()
        earlier = records.pop(self.stage, None)
        is_same = earlier is None or earlier.has_settings(new.settings)
        others = [record for record in records.values() if {*record.writes} & {*new.writes}]
        if "predictions" in new.writes and not is_same and "fuse" in records:
            # Votes on labels that are replaced are outdated too.
            others.append(records["fuse"])
        return EarlierRecords(stage=earlier, is_same=is_same, others=others)

    def _require_unclaimed(self, new: StageRecord, earlier: EarlierRecords) -> None:
        """Refuse to replace results of other settings or of other stages."""
        if earlier.stage is not None:
            require_same_settings(self.record_path, earlier.stage.settings, new.settings)
        if earlier.others:
            other = earlier.others[0]
            folder = next(name for name in new.writes if name in other.writes)
            problem = f"{folder}/ contains results of `{other.stage}`"
            hint = f"use another output folder, or {setting('overwrite', True)} to replace them"
            raise OutputError(self.manifest.path(other.stage), problem, hint=hint)

    def _require_idle(self, earlier: EarlierRecords) -> None:
        """Refuse to replace results that another run is writing."""
        # Asked in any case, since it removes the locks of killed runs.
        is_shared = self.is_shared()
        if is_shared and not earlier.is_same:
            raise self.busy()
        for record in earlier.others:
            folder = OwnedFolder(self.root, record.stage)
            if folder.is_shared():
                raise folder.busy()

    def _remove_outdated(self, new: StageRecord, earlier: EarlierRecords) -> list[Path]:
        """Remove outdated results; return the files that stay, since users have changed them."""
        foreign: list[Path] = []
        recorded: set[str] = set()
        if earlier.stage is not None:
            recorded.update(earlier.stage.writes)
            if not earlier.is_same:
                foreign += self.remove_written(self._results_in(earlier.stage.writes))
        for other in earlier.others:
            recorded.update(other.writes)
            foreign += self._take_over(other, new.writes)
        unrecorded = [name for name in new.writes if name not in recorded]
        foreign += self._remove_unrecorded(unrecorded)
        return foreign

    def _continued(
        self, new: StageRecord, earlier: EarlierRecords, foreign: Iterable[Path]
    ) -> StageRecord:
        """Return the record to write: the new one, with what the same settings wrote before."""
        names = {path.relative_to(self.root).as_posix() for path in foreign}
        continued = earlier.stage if earlier.is_same else None
        settings = self._settings_with_files(new, continued)
        if continued is None:
            return replace(new, settings=settings, foreign=tuple(sorted(names)))
        return replace(
            new,
            settings=settings,
            writes=tuple(sorted({*continued.writes, *new.writes})),
            scans=merged_sources((continued.scans, new.scans)),
            moved={**continued.moved, **new.moved},
            foreign=tuple(sorted({*continued.foreign, *names})),
        )

    def _settings_with_files(
        self, new: StageRecord, continued: StageRecord | None
    ) -> Mapping[str, object]:
        """Return the settings to record, and write the files of digests that they name.

        `continued`: the earlier record with the same settings, which may hold the digests itself.
        """
        if continued and not names_files(continued.settings):
            return with_new_scales(continued.settings, new.settings)
        settings = with_files(new.settings, self.root)
        return continued.settings if continued else settings

    def _take_over(self, other: StageRecord, folders: Collection[str]) -> list[Path]:
        """Remove results of another stage from folders, and results that depend on its labels.

        The record of the other stage then names only the folders that it still has results in.
        """
        taken = set(folders)
        if "predictions" in folders:
            # These were computed from the labels that are removed.
            taken |= {ERROR, DISAGREEMENT, "views"}
        removed = [name for name in other.writes if name in taken]
        remaining = [name for name in other.writes if name not in taken]
        foreign = self.remove_written(self._results_in(removed))
        self.manifest.write(replace(other, writes=tuple(remaining)))
        return foreign

    def _remove_unrecorded(self, folders: Iterable[str]) -> list[Path]:
        """Refuse or remove results that no stage recorded: their settings are unknown."""
        return self.remove_written(self._require_recorded(folders))

    def _require_recorded(self, folders: Iterable[str]) -> list[Path]:
        """Return the results that no stage recorded; refuse them unless they are replaced."""
        results = self._results_in(folders)
        if results and not self.overwrite:
            overwriting = f"{setting('overwrite', True)} to replace what salsanext wrote"
            hint = f"use another output folder, or {overwriting}"
            raise OutputError(results[0], "is a result that no stage recorded", hint=hint)
        return results

    def _results_in(self, folders: Iterable[str]) -> list[Path]:
        return [path for name in folders for path in find_outputs(self.root, name).values()]


def encode_array(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    with io.BytesIO() as file:
        np.save(file, np.ascontiguousarray(array), allow_pickle=False)
        return file.getvalue()


def _scan_sources(out: Path, scans: Iterable[ScanFile]) -> dict[str, ScanSource]:
    """Return the sources of scans by sequence; refuse others than the recorded sources."""
    recorded_sources = Manifest(out).sources()
    folders: dict[str, str] = {}
    suffixes: dict[str, dict[str, str]] = {}
    for scan in scans:
        folder = folders.setdefault(scan.sequence, str(scan.path.parent))
        recorded = recorded_sources.get(scan.sequence, ScanSource(folder, {}))
        _require_recorded_source(out, scan, recorded)
        suffixes.setdefault(scan.sequence, {})[scan.stem] = scan.suffix
    return {name: ScanSource(folders[name], suffixes[name]) for name in folders}


def _require_recorded_source(out: Path, scan: ScanFile, recorded: ScanSource) -> None:
    """Refuse a scan if the folder has results of another one in its place."""
    path = recorded.path(scan)
    if path != scan.path:
        problem = f"results of sequence {scan.sequence} are of {path}"
        hint = f"use another output folder for {scan.path}"
        raise OutputError(out, problem, "the same scans", hint)


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
    moved: Mapping[str, str] = MappingProxyType({}),
    weights: Path | None = None,
    options: Mapping[str, object] = MappingProxyType({}),
) -> Iterator[OutputRun]:
    """Record the run of a stage in `OUT/<stage>.json`, or refuse to mix it with other results.

    Runs with the same settings may share the folder; runs with other settings must wait. What is
    removed from the folder is decided by `OutputRun.claim`. The first run of a stage that ends
    without any result leaves neither a record nor an empty folder.

    Parameters
    ----------
    out : Path
        Output folder.
    stage : str
        Name of the record.
    settings : StageSettings
        Settings that decide the results.
    folders : iterable of str
        Folders of the results, keys of `SUFFIX_OF_FOLDER`.
    scans : sequence of ScanFile
        Scans of the run.
    overwrite : bool
        Whether existing results are replaced.
    record_scans : bool
        Whether to record where the scans are; not for a stage on the scans of an earlier one.
    moved : mapping of str to str
        Folder by sequence of scans that were moved since an earlier stage recorded them, to be
        recorded instead of that of an earlier run.
    weights : Path, optional
        File that the user named, whose path is recorded.
    options : mapping of str to object
        Further settings of the network that the user named, by argument.

    Yields
    ------
    OutputRun
    """
    # Contradicting scans are an error before a folder is created.
    sources = _scan_sources(out, scans) if record_scans else {}
    run = OutputRun(out, stage, folders=tuple(folders), overwrite=overwrite)
    new = StageRecord(
        stage=stage,
        settings=settings_json(settings),
        writes=tuple(sorted(run.folders)),
        scans=sources,
        moved=moved,
        weights_file=str(weights.absolute()) if weights else "",
        options=options,
    )
    with remove_if_empty(out), ExitStack() as stack:
        with run.locked_records():
            is_first = run.manifest.record(stage) is None
            claimed = run.claim(new)
            if is_first:
                stack.callback(run.withdraw)
            stack.enter_context(run.open(shared=True))
        yield _with_foreign_files(run, claimed, scans)
        _require_still_recorded(run, new)


def foreseen_run(
    out: Path,
    stage: str,
    settings: StageSettings,
    folders: Iterable[str],
    scans: Sequence[ScanFile],
    *,
    overwrite: bool,
    record_scans: bool = True,
) -> OutputRun:
    """Return the run that `output_run` would begin, without writing; arguments as of it."""
    sources = _scan_sources(out, scans) if record_scans else {}
    run = OutputRun(out, stage, folders=tuple(folders), overwrite=overwrite)
    writes = tuple(sorted(run.folders))
    new = StageRecord(stage=stage, settings=settings_json(settings), writes=writes, scans=sources)
    return _with_foreign_files(run, run.foresee(new), scans)


def _with_foreign_files(
    run: OutputRun, claimed: StageRecord, scans: Sequence[ScanFile]
) -> OutputRun:
    """Return a run with the files of the user where results of its scans belong."""
    # Foreign files of other settings are no results, so that their scans are not done.
    foreign = run.foreign_files(run.root / name for name in claimed.foreign)
    run = replace(run, foreign=frozenset(foreign))
    todo = [path for file in scans if not run.is_done(file) for path in run.paths(file)]
    return replace(run, foreign=frozenset(run.foreign_files(todo)))


def _require_still_recorded(run: OutputRun, new: StageRecord) -> None:
    """Refuse results of a folder whose record another process or the user has changed since."""
    record = run.manifest.record(run.stage)
    if record is None or not record.has_settings(new.settings):
        problem = "was removed or replaced while results were written into it"
        hint = f"run again with {setting('overwrite', True)}"
        raise OutputError(run.root, problem, hint=hint)
