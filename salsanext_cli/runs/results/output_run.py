# SPDX-License-Identifier: MIT
"""Runs of stages in an output folder, where several stages write results of the same scans."""

import io
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.runs.records.digest_files import names_files, with_files
from salsanext_cli.runs.records.stage_settings import StageSettings
from salsanext_cli.runs.results.manifest import (
    Manifest,
    ScanSource,
    StageRecord,
    merged_sources,
    require_same_settings,
    settings_json,
)
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.results.paths import (
    DISAGREEMENT,
    ERROR,
    ScanFile,
    find_outputs,
    output_path,
)


@dataclass(frozen=True, slots=True)
class OutputRun(OwnedFolder):
    """One run of a stage in an output folder, shared with other runs of the same settings."""

    folders: tuple[str, ...] = ()  # Folders of results, keys of `SUFFIX_OF_FOLDER`
    overwrite: bool = False  # Whether existing results are computed again
    # Foreign files in the place of results that are missing or of other settings
    foreign: frozenset[Path] = frozenset()

    def path(self, file: ScanFile, folder: str) -> Path:
        """Return the path of a result of a scan."""
        return output_path(self.root, file.sequence, folder, file.stem)

    def paths(self, file: ScanFile) -> list[Path]:
        """Return the paths of all results of a scan."""
        return [self.path(file, folder) for folder in self.folders]

    def is_there(self, file: ScanFile) -> bool:
        """Return whether a scan has all its results."""
        return all(filled(path) and path not in self.foreign for path in self.paths(file))

    def names_of_results(self, names: Iterable[str]) -> set[str]:
        """Return the names, as `ScanFile.name`, of the scans that have all their results."""
        parts = {name: name.rpartition("/") for name in names}
        files = {
            name: ScanFile(sequence=part[0], stem=part[2], path=self.root)
            for name, part in parts.items()
        }
        return {name for name, file in files.items() if self.is_there(file)}

    def is_done(self, file: ScanFile) -> bool:
        """Return whether a scan has all its results, which are not to be overwritten."""
        return not self.overwrite and self.is_there(file)

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

    def claim(self, wanted: StageRecord) -> StageRecord:
        """Update the locked records and remove outdated results for this run, or refuse."""
        records = self.manifest.records()
        earlier = records.pop(self.stage, None)
        before = earlier or StageRecord(stage=self.stage, settings=wanted.settings)
        same = before.has_settings(wanted.settings)
        others = [record for record in records.values() if {*record.writes} & {*wanted.writes}]
        if not self.overwrite:
            require_same_settings(self.record_path, before.settings, wanted.settings)
            if others:
                raise self._taken(wanted, others[0])
        if "predictions" in wanted.writes and not same and "fuse" in records:
            others.append(records["fuse"])
        # Nothing but locks of killed runs is removed before it is certain that the run may begin.
        # Runs with the same settings may share the folder.
        self._require_unused(others if same else [before, *others])
        foreign = [] if same else self.remove_written(self._results_in(before.writes))
        for other in others:
            foreign += self._take_over(other, wanted.writes)
        recorded = {folder for record in (before, *others) for folder in record.writes}
        foreign += self._remove_unrecorded(name for name in wanted.writes if name not in recorded)
        names = {path.relative_to(self.root).as_posix() for path in foreign}
        settings = self._settings_with_files(wanted, earlier if same else None)
        merged = replace(wanted, settings=settings, foreign=tuple(sorted(names)))
        if same:
            merged = replace(
                merged,
                writes=tuple(sorted({*before.writes, *wanted.writes})),
                scans=merged_sources((before.scans, wanted.scans)),
                foreign=tuple(sorted({*before.foreign, *names})),
            )
        # The record comes last, so that the next run repeats what a killed run did not finish.
        self.manifest.write(merged)
        return merged

    def _taken(self, wanted: StageRecord, other: StageRecord) -> OutputError:
        """Return the error of a folder of results that another stage fills."""
        folder = next(name for name in wanted.writes if name in other.writes)
        problem = f"{folder}/ contains results of `{other.stage}`"
        hint = f"use another output folder, or {setting('overwrite', True)} to replace them"
        return OutputError(self.manifest.path(other.stage), problem, hint=hint)

    def _require_unused(self, records: Iterable[StageRecord]) -> None:
        """Refuse to replace results of stages of which a run uses the folder."""
        for record in records:
            stage_folder = OwnedFolder(self.root, record.stage)
            if stage_folder.is_shared():
                raise stage_folder.busy()

    def _settings_with_files(
        self, wanted: StageRecord, same: StageRecord | None
    ) -> Mapping[str, object]:
        """Return the settings to record, and write the files of digests that they name.

        `same`: the earlier record with the same settings, which may hold the digests itself.
        """
        if same and not names_files(same.settings):
            return same.settings
        settings = with_files(wanted.settings, self.root)
        return same.settings if same else settings

    def _take_over(self, other: StageRecord, folders: Collection[str]) -> list[Path]:
        """Remove results of another stage from folders, and results that depend on its labels."""
        taken = {*folders, ERROR, DISAGREEMENT, "views"} if "predictions" in folders else {*folders}
        foreign = self.remove_written(self._results_in(n for n in other.writes if n in taken))
        remaining = tuple(name for name in other.writes if name not in taken)
        self.manifest.write(replace(other, writes=remaining))
        return foreign

    def _remove_unrecorded(self, folders: Iterable[str]) -> list[Path]:
        """Refuse or remove results that no stage recorded: their settings are unknown."""
        results = self._results_in(folders)
        if results and not self.overwrite:
            hint = f"use another output folder, or {setting('overwrite', True)} to work beside it"
            raise OutputError(results[0], "is a result that no stage recorded", hint=hint)
        return self.remove_written(results)

    def _results_in(self, folders: Iterable[str]) -> list[Path]:
        return [path for name in folders for path in find_outputs(self.root, name).values()]


def encode_array(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    with io.BytesIO() as file:
        np.save(file, np.ascontiguousarray(array), allow_pickle=False)
        return file.getvalue()


def _scan_sources(out: Path, scans: Iterable[ScanFile]) -> dict[str, ScanSource]:
    """Return the sources of scans by sequence; refuse others than the recorded sources."""
    known = Manifest(out).sources()
    suffixes = dict[str, dict[str, str]]()
    folders = dict[str, str]()
    for scan in scans:
        suffix = scan.path.name[len(scan.stem) :]
        folder = folders.setdefault(scan.sequence, str(scan.path.parent))
        recorded = known.get(scan.sequence, ScanSource(folder, {}))
        other = scan.stem + (recorded.suffixes.get(scan.stem) or suffix)
        if recorded.folder != str(scan.path.parent) or other != scan.path.name:
            problem = f"results of sequence {scan.sequence} are of {Path(recorded.folder, other)}"
            hint = f"use another output folder for {scan.path}"
            raise OutputError(out, problem, "the same scans", hint)
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
    weights: Path | None = None,
) -> Iterator[OutputRun]:
    """Record the run of a stage in `OUT/<stage>.json`, or refuse to mix it with other results.

    Runs with the same settings may share the folder; runs with other settings must wait.
    `record_scans`: False for a stage that works on the scans of an earlier one. `weights`: file
    that the user named, whose path is recorded.
    """
    # Contradicting scans are an error before a folder is created.
    sources = _scan_sources(out, scans) if record_scans else {}
    run = OutputRun(out, stage, folders=tuple(folders), overwrite=overwrite)
    wanted = StageRecord(
        stage=stage,
        settings=settings_json(settings),
        writes=tuple(sorted(run.folders)),
        scans=sources,
        weights_file=str(weights.absolute()) if weights else "",
    )
    with ExitStack() as stack:
        with run.locked_records():
            recorded = run.claim(wanted)
            stack.enter_context(run.open(shared=True))
        # Foreign files of other settings are no results, so that their scans are not done.
        others = run.foreign_files(out / name for name in recorded.foreign)
        run = replace(run, foreign=frozenset(others))
        todo = [path for file in scans if not run.is_done(file) for path in run.paths(file)]
        yield replace(run, foreign=frozenset(run.foreign_files(todo)))
        record = run.manifest.record(stage)
        if record is None or not record.has_settings(wanted.settings):
            problem = "was removed or replaced while results were written into it"
            hint = f"run again with {setting('overwrite', True)}"
            raise OutputError(out, problem, hint=hint)
