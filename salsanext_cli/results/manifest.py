# SPDX-License-Identifier: MIT
"""Manifest of a folder that stages fill: who wrote what, with which settings, of which scans.

``FOLDER/<stage>.json`` is the record of a stage: its settings, the folders of results that it
fills, and the scans that it was asked for. `OwnedFolder` lists the files themselves.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import OutputError, first_few, shortened
from salsanext_cli.files.identity import identity
from salsanext_cli.files.json_files import (
    Json,
    as_json,
    decoded,
    plain,
    read_json,
    record_of,
    write_json,
)
from salsanext_cli.formats import scan_suffix
from salsanext_cli.results.paths import COLOURINGS, SUFFIX_OF_FOLDER
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.version import __version__

MAX_PATH_CHARACTERS = 500
RESULT_STAGES = (
    *("project", "predict", "knn-refine", "uncertainty", "fuse", "picture", "export-ply"),
    *(f"export-ply-{colour}" for colour in COLOURINGS),
)


@dataclass(frozen=True, slots=True)
class ScanSource:
    """Scans of one sequence that a stage worked on."""

    folder: str  # Folder of the scans, absolute
    # Suffixes of the files by stem, of those that the stage was asked for in any of its runs, done
    # or failed; empty for scans of a recording, and in older records
    suffixes: Mapping[str, str]

    def to_dict(self) -> dict[str, object]:
        """Return the entry of a sequence, with the names of its files."""
        names = sorted(map("".join, self.suffixes.items()))
        return {"folder": self.folder, "asked_for": names}

    @classmethod
    def from_dict(cls, entry: Json) -> "ScanSource":
        """Read the entry of a sequence; anything amiss raises a `TypeError` or the like."""
        folder, *names = decoded(list[str], [entry["folder"], *entry["asked_for"]])
        if "\0" in folder:
            raise ValueError("a folder with a NUL in its name")
        stems = [name[: len(name) - len(scan_suffix(name))] for name in names]
        return cls(folder, {s: n[len(s) :] for s, n in zip(stems, names, strict=True)})


def merged_sources(several: Iterable[Mapping[str, ScanSource]]) -> dict[str, ScanSource]:
    """Return all files of each sequence."""
    merged: dict[str, ScanSource] = {}
    for name, source in (item for sources in several for item in sources.items()):
        known = merged.get(name, source).suffixes
        added = {stem: suffix or known.get(stem, "") for stem, suffix in source.suffixes.items()}
        merged[name] = ScanSource(source.folder, {**known, **added})
    return merged


@dataclass(frozen=True, slots=True)
class StageRecord:
    """Record of the runs of a stage, all with the same settings."""

    stage: str  # Its name on the command line
    settings: Mapping[str, object]  # As `settings_json` returns them
    # Folders of results that the stage fills, keys of `SUFFIX_OF_FOLDER`
    writes: tuple[str, ...] = ()
    # By sequence; empty for a stage that works on what earlier ones recorded
    scans: Mapping[str, ScanSource] = field(default_factory=dict)
    # Results of other settings or origin that were not removed, as paths below the folder
    kept: tuple[str, ...] = ()
    version: str = __version__  # Of the program that wrote it

    def __post_init__(self) -> None:
        if unknown := {*self.writes} - {*SUFFIX_OF_FOLDER}:
            raise ValueError(f"no folder of results is named {min(unknown)}")

    def to_dict(self) -> dict[str, object]:
        """Return the content of the record's file; what may be long comes last."""
        names = ("stage", "version", "writes", "settings", "scans", "kept")
        content = {name: plain(getattr(self, name)) for name in names}
        return {name: value for name, value in content.items() if value or name == "settings"}

    def has_settings(self, settings: Mapping[str, object]) -> bool:
        """Return whether settings are those of the record."""
        return not differences(self.settings, settings)


def settings_json(settings: object) -> dict[str, object]:
    """Return settings as a record has them: as a file gives them back, without what is None."""
    return {key: value for key, value in as_json(settings).items() if value is not None}


@lru_cache(4 * len(RESULT_STAGES))  # Of some folders
def _read(path: Path, stage: str, _: tuple[object, ...]) -> StageRecord | None:
    content = read_json(path)
    if content is None:
        return None
    if content.get("stage") != stage:
        hint = "delete it or use another folder"
        raise OutputError(path, f"not what `{stage}` writes", hint=hint)
    if "settings" not in content and stage not in RESULT_STAGES:
        # Some stages of older versions wrote their settings without a table.
        settings = {key: each for key, each in content.items() if key not in ("stage", "version")}
        content = {"stage": stage, "settings": settings}
    return record_of(StageRecord, content, path)


@lru_cache(4 * len(RESULT_STAGES))
def _settings(path: Path, stage: str, state: tuple[object, ...]) -> StageSettings | None:
    record = _read(path, stage, state)
    return record_of(StageSettings, record.settings, path) if record else None


@dataclass(frozen=True, slots=True)
class Manifest:
    """Records of the stages that ran in a folder, read when they are asked for."""

    root: Path

    def path(self, stage: str) -> Path:
        """Return the path of the record of a stage."""
        return self.root / f"{stage}.json"

    def record(self, stage: str) -> StageRecord | None:
        """Return the record of a stage, shared by all that ask; None if it did not run here."""
        path = self.path(stage)
        return _read(path, stage, identity(path))

    def records(self) -> dict[str, StageRecord]:
        """Read the records of all stages that ran here, by stage."""
        records = {stage: self.record(stage) for stage in RESULT_STAGES}
        return {stage: record for stage, record in records.items() if record is not None}

    def write(self, record: StageRecord) -> None:
        """Write the record of a stage, durably, unless it is there."""
        if self.record(record.stage) != record:
            write_json(self.path(record.stage), record)

    def sources(self) -> dict[str, ScanSource]:
        """Return where the scans of all stages came from, by sequence."""
        return merged_sources(record.scans for record in self.records().values())

    def settings(self, stage: str) -> StageSettings | None:
        """Return the settings a stage ran with, None if it did not."""
        path = self.path(stage)
        return _settings(path, stage, identity(path))

    def owner(self, *folders: str) -> str | None:
        """Return the stage that writes the first of some folders of results that any writes."""
        writers = {f: stage for stage, r in reversed(self.records().items()) for f in r.writes}
        return next((writers[folder] for folder in folders if folder in writers), None)

    def settings_of(self, *folders: str) -> StageSettings | None:
        """Return the settings behind the first of some folders of results that a stage recorded."""
        stage = self.owner(*folders)
        return self.settings(stage) if stage else None

    def origins(self, stages: Iterable[str]) -> dict[str, str]:
        """Return a digest of the settings of each of the stages that ran, for later records."""
        records = filter(None, map(self.record, stages))
        texts = {each.stage: json.dumps(each.settings, sort_keys=True) for each in records}
        return {s: hashlib.sha256(text.encode()).hexdigest()[:12] for s, text in texts.items()}


def require_same_settings(
    path: Path, recorded: Mapping[str, object], settings: Mapping[str, object]
) -> None:
    """Refuse to mix or to replace what was made with other settings, and name these."""
    if found := differences(recorded, settings):
        hint = "use another output folder, or --overwrite to replace all its results"
        raise OutputError(path, f"made with other settings: {found}", hint=hint)


def differences(recorded: Mapping[str, object], settings: Mapping[str, object]) -> str:
    """Describe how settings that were recorded differ from others, empty if they do not."""
    before, after = dict(_flat(recorded)), dict(_flat(settings))
    changed = sorted(k for k in before.keys() | after if before.get(k) != after.get(k))
    return first_few([_difference(k, before.get(k), after.get(k)) for k in changed])


def _difference(key: str, before: Any, after: Any) -> str:
    """Describe how a setting differs; of lists of one length, name the first value that does."""
    if key == "sensor.intensity_quantiles":
        was, now = (("matched" if any(q) else "none") if q else "raw" for q in (before, after))
        now = "matched to other scans" if now == was else now
        return f"intensity was {was} and is {now} (--intensity)"
    if key.startswith("origins."):
        return f"`{key.removeprefix('origins.')}` has replaced its results since"
    if isinstance(before, dict) and isinstance(after, dict):
        old, new = (LabelSpace.from_dict(space, key) for space in (before, after))
        return f"{key} ({first_few(old.differences(new))})"
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        place = next(i for i, value in enumerate(before) if value != after[i])
        key, before, after = f"{key}[{place}]", before[place], after[place]
    was, now = (
        "not set" if value is None else shortened(json.dumps(value, ensure_ascii=False), 40)
        for value in (before, after)
    )
    return f"{key} was {was} and is {now}"


def _flat(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted key and value of nested settings that are set; a label space stays whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and key != "label_space":
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield prefix + key, value
