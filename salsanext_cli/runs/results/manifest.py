# SPDX-License-Identifier: MIT
"""Manifest of a folder that stages fill: stages, settings, scans, classes, sensor and weights.

``FOLDER/<stage>.json`` is the record of a stage: its settings, the folders of results that it
fills, and the scans that it was asked for. `OwnedFolder` lists the files themselves.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal, TypeVar, overload

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.plain_data import Json, as_json, decoded, plain
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.json_files import read_json, record_of, write_json
from salsanext_cli.io.files.reading import identity
from salsanext_cli.io.formats import scan_suffix
from salsanext_cli.runs.records.digest_files import with_names, without_names
from salsanext_cli.runs.records.stage_settings import (
    FuseSettings,
    PictureSettings,
    PredictSettings,
    ProjectSettings,
    StageSettings,
    UncertaintySettings,
    settings_type,
)
from salsanext_cli.runs.results.folder_names import COLOURINGS, SUFFIX_OF_FOLDER
from salsanext_cli.runs.results.setting_differences import differences
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.version import __version__

Kind = TypeVar("Kind")
RESULT_STAGES = (
    *("project", "predict", "knn-refine", "uncertainty", "fuse", "picture", "export-ply"),
    *(f"export-ply-{colour}" for colour in COLOURINGS),
    "export-las",
    "export-laz",
)


@dataclass(frozen=True, slots=True)
class ScanSource:
    """Scans of one sequence that runs of a stage were asked for."""

    folder: str  # Absolute
    suffixes: Mapping[str, str]  # By stem; empty for scans of a recording, and in older records

    def path(self, scan: ScanFile) -> Path:
        """Return where a scan was recorded; a suffix that was not recorded is that of the scan."""
        suffix = self.suffixes.get(scan.stem) or scan.suffix
        return Path(self.folder, scan.stem + suffix)

    def to_dict(self) -> dict[str, object]:
        """Return the entry of a sequence, with the names of its files."""
        return {"folder": self.folder, "asked_for": sorted(map("".join, self.suffixes.items()))}

    @classmethod
    def from_dict(cls, entry: Json) -> "ScanSource":
        """Read the entry of a sequence; raise a `TypeError` or the like for any other data."""
        folder = decoded(str, entry["folder"])
        names = decoded(list[str], entry["asked_for"])
        if "\0" in folder:
            raise ValueError("a folder with a NUL in its name")
        suffixes: dict[str, str] = {}
        for name in names:
            stem = name[: len(name) - len(scan_suffix(name))]
            suffixes[stem] = name[len(stem) :]
        return cls(folder, suffixes)


def merged_sources(sources: Iterable[Mapping[str, ScanSource]]) -> dict[str, ScanSource]:
    """Return the union of the files of each sequence."""
    merged: dict[str, ScanSource] = {}
    for sources_of_stage in sources:
        for sequence, source in sources_of_stage.items():
            recorded = merged.get(sequence, source).suffixes
            added = {
                stem: suffix or recorded.get(stem, "") for stem, suffix in source.suffixes.items()
            }
            merged[sequence] = ScanSource(source.folder, {**recorded, **added})
    return merged


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRecord:
    """Record of the runs of a stage, all with the same settings."""

    stage: str  # Name on the command line
    settings: Mapping[str, object]  # As `settings_json` returns them
    writes: tuple[str, ...] = ()  # Folders of results, keys of `SUFFIX_OF_FOLDER`
    # By sequence; empty for a stage that works on the results of earlier stages
    scans: Mapping[str, ScanSource] = field(default_factory=dict)
    # Folder by sequence of scans that an earlier stage recorded elsewhere, when a run used them
    moved: Mapping[str, str] = field(default_factory=dict)
    # Files of other settings or origin that were not removed, as paths below the folder
    foreign: tuple[str, ...] = ()
    weights_file: str = ""  # Absolute path that the last run was given; empty for the default
    # Further settings of the network that the last run was given, by argument; paths are absolute
    options: Mapping[str, object] = field(default_factory=dict)
    version: str = __version__

    def __post_init__(self) -> None:
        unknown = {*self.writes} - {*SUFFIX_OF_FOLDER}
        if unknown:
            raise ValueError(f"unknown folder of results {min(unknown)}")

    def to_dict(self) -> dict[str, object]:
        """Return the content of the record's file, long values last."""
        names = ["stage", "version", "writes", "settings", "scans", "moved", "foreign"]
        names += ["weights_file", "options"]
        content = {name: plain(getattr(self, name)) for name in names}
        return {name: value for name, value in content.items() if value or name == "settings"}

    def has_settings(self, settings: Mapping[str, object]) -> bool:
        """Return whether the record has the same settings."""
        return not differences(with_names(self.settings), with_names(settings))


def settings_json(settings: object) -> dict[str, object]:
    """Return settings as a record contains them: read back from JSON, without None."""
    return {key: value for key, value in as_json(settings).items() if value is not None}


RENAMED = {"promised": "guarantee", "kept": "foreign"}
"""Keys of older records."""
FORMER = {new: old for old, new in RENAMED.items()}


@lru_cache(4 * len(RESULT_STAGES))  # Enough for some folders
def _read(path: Path, stage: str, _: tuple[object, ...]) -> StageRecord | None:
    content = read_json(path)
    if content is None:
        return None
    if content.get("stage") != stage:
        hint = "delete it or use another folder"
        raise OutputError(path, f"is not a record of `{stage}`", hint=hint)
    content = {RENAMED.get(key, key): value for key, value in content.items()}
    settings = content.get("settings")
    if isinstance(settings, dict):
        content["settings"] = _current_settings(settings)
    return record_of(StageRecord, content, path)


def _current_settings(settings: Mapping[str, object]) -> dict[str, object]:
    """Return the settings of a record as this version writes them.

    Older versions recorded scales of values that did not vary, which have no extent.
    """
    current = {RENAMED.get(key, key): value for key, value in settings.items()}
    scales = current.get("scales")
    if isinstance(scales, dict):
        current["scales"] = {
            colour: ends for colour, ends in scales.items() if not _has_equal_ends(ends)
        }
    return current


def _has_equal_ends(ends: object) -> bool:
    """Return whether a recorded scale has no extent; not for what is no scale."""
    return isinstance(ends, list) and len(ends) > 1 and ends[0] == ends[-1]


@lru_cache(4 * len(RESULT_STAGES))
def _settings(path: Path, stage: str, state: tuple[object, ...]) -> StageSettings | None:
    record = _read(path, stage, state)
    if record is None:
        return None
    return record_of(settings_type(stage), without_names(record.settings), path)


@lru_cache(4)  # Each failing scan of a run has a hint, for which the sources are merged.
def _sources(root: Path, _: tuple[object, ...]) -> dict[str, ScanSource]:
    """Return the sources of all stages in a folder; the last argument changes with the records."""
    return merged_sources(record.scans for record in Manifest(root).records().values())


@dataclass(frozen=True, slots=True)
class Manifest:
    """Records of the stages that ran in a folder, read on demand."""

    root: Path

    def path(self, stage: str) -> Path:
        """Return the path of the record of a stage."""
        return self.root / f"{stage}.json"

    def record(self, stage: str) -> StageRecord | None:
        """Return the shared record of a stage, None if it did not run here."""
        path = self.path(stage)
        return _read(path, stage, identity(path))

    def records(self) -> dict[str, StageRecord]:
        """Read the records of all stages that ran here, by stage."""
        records = {stage: self.record(stage) for stage in RESULT_STAGES}
        return {stage: record for stage, record in records.items() if record is not None}

    def write(self, record: StageRecord) -> None:
        """Write the record of a stage durably if it has changed."""
        if self.record(record.stage) != record:
            write_json(self.path(record.stage), record)

    def sources(self) -> dict[str, ScanSource]:
        """Return the sources of the scans of all stages, by sequence."""
        paths = tuple(map(self.path, RESULT_STAGES))
        return dict(_sources(self.root, tuple(map(identity, paths))))

    @overload
    def settings(self, stage: Literal["project"]) -> ProjectSettings | None: ...
    @overload
    def settings(self, stage: Literal["predict"]) -> PredictSettings | None: ...
    @overload
    def settings(self, stage: Literal["uncertainty"]) -> UncertaintySettings | None: ...
    @overload
    def settings(self, stage: Literal["fuse"]) -> FuseSettings | None: ...
    @overload
    def settings(self, stage: Literal["picture"]) -> PictureSettings | None: ...
    @overload
    def settings(self, stage: str) -> StageSettings | None: ...
    def settings(self, stage: str) -> StageSettings | None:
        """Return the settings of a stage, None if it did not run here."""
        path = self.path(stage)
        return _settings(path, stage, identity(path))

    def owner(self, *folders: str) -> str | None:
        """Return the stage that writes the first recorded one of some folders of results."""
        records = self.records()
        for folder in folders:
            for stage, record in records.items():
                if folder in record.writes:
                    return stage
        return None

    def settings_of(self, *folders: str) -> StageSettings | None:
        """Return the settings of the owner of some folders of results."""
        stage = self.owner(*folders)
        return self.settings(stage) if stage else None


def require_same_settings(
    path: Path, recorded: Mapping[str, object], settings: Mapping[str, object]
) -> None:
    """Refuse to mix or to replace results of other settings, and name the differences."""
    changed = differences(with_names(recorded), with_names(settings))
    if changed:
        overwrite = setting("overwrite", True)
        hint = f"use another output folder, or {overwrite}, which first removes all its results"
        raise OutputError(path, f"was made with other settings: {changed}", hint=hint)
