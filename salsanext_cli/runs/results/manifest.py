# SPDX-License-Identifier: MIT
"""Manifest of a folder that stages fill: stages, settings, scans, classes, sensor and weights.

``FOLDER/<stage>.json`` is the record of a stage: its settings, the folders of results that it
fills, and the scans that it was asked for. `OwnedFolder` lists the files themselves.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, TypeVar, overload

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.classes.merging import ClassMerging, contradiction
from salsanext_cli.core.errors import LabelError, OutputError
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.plain_data import Json, as_json, decoded, plain
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.json_files import read_json, record_of, write_json
from salsanext_cli.io.files.reading import identity
from salsanext_cli.io.formats import scan_suffix
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.records.digest_files import (
    NO_SCANS,
    RecordedScans,
    digests_of_guarantee,
    recorded_scans,
    with_names,
    without_names,
)
from salsanext_cli.runs.records.stage_settings import (
    FuseSettings,
    PictureSettings,
    PredictSettings,
    ProjectSettings,
    RefineSettings,
    StageSettings,
    UncertaintySettings,
    WeightsSettings,
    settings_type,
)
from salsanext_cli.runs.results.paths import COLOURINGS, ERROR, SUFFIX_OF_FOLDER, ScanFile
from salsanext_cli.runs.results.selection import space_of
from salsanext_cli.runs.results.setting_differences import differences
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
        names = ["stage", "version", "writes", "settings", "scans", "foreign"]
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
        return merged_sources(record.scans for record in self.records().values())

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

    def origins(self, stages: Iterable[str]) -> dict[str, str]:
        """Return digests of the settings of stages that ran, for the records of later stages."""
        digests: dict[str, str] = {}
        for stage in stages:
            record = self.record(stage)
            if record is None:
                continue
            # Digests that older versions recorded are of their keys.
            settings = {FORMER.get(key, key): value for key, value in record.settings.items()}
            text = json.dumps(settings, sort_keys=True)
            digests[stage] = hashlib.sha256(text.encode()).hexdigest()[:12]
        return digests

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first recorded folder, by default of the predictions."""
        settings = self.settings_of(*(folders or ("predictions", "pixel_labels")))
        return self._recorded(settings.label_space, "label space") if settings else None

    def compared_space(
        self,
        scans: Sequence[ScanFile],
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
        *,
        other_ids: bool = False,
    ) -> LabelSpace:
        """Return the classes in which predictions and labels are compared, with the labels' splits.

        They are the classes of the predictions, which may be merged classes of the labels, or
        `classes`, into which both are merged. `space`: classes of the labels, by default of the
        data set; `other_ids`: whether labels may have other raw ids for classes of the same names.
        """
        recorded = self.label_space()
        space = space or space_of(scans, recorded)
        target = classes or recorded or space
        named_alike = other_ids and space.names == target.names
        if classes is not None:
            ClassMerging.needed(recorded or space, classes)
            if not named_alike:
                ClassMerging.needed(space, classes)
        elif target.fits(space):
            return space
        elif not named_alike and contradiction(space, target):
            named = first_few(target.differences(space))
            problem = f"has predictions in the classes of {target.name} ({named})"
            merged = f"merge both with {argument('classes')}"
            hint = f"predict with weights for the classes of the labels, or {merged}"
            raise LabelError(self.root, problem, f"{space.name}, as the labels", hint)
        return replace(target, splits=space.splits or (classes or space).splits)

    def merging_into(self, space: LabelSpace) -> ClassMerging | None:
        """Return the merging of the classes of the probabilities into a label space, if needed."""
        finer = self.label_space("probabilities")
        return None if finer is None or finer.fits(space) else ClassMerging.between(finer, space)

    def prediction(self) -> PredictSettings | None:
        """Return the settings of `predict`, None if the labels are not its own."""
        return self.settings("predict") if self.owner("predictions") == "predict" else None

    def risk_threshold(self, space: LabelSpace) -> RiskThreshold | None:
        """Return the guarantee of `tune risk` for the labels, if they are in its classes."""
        prediction = self.prediction()
        recorded = self.label_space("predictions")
        if prediction is None or recorded is None or not recorded.fits(space):
            return None
        return prediction.guarantee

    def recorded_sensor(self) -> Sensor | None:
        """Return the recorded sensor of the results, if there is one."""
        folders = ("pixel_labels", "predictions", "uncertainty/epistemic", "range")
        settings = self.settings_of(*folders)
        return self._recorded(settings.sensor, "sensor") if settings else None

    def sensor(self) -> Sensor:
        """Return the recorded sensor of the results, else the HDL-64."""
        return self.recorded_sensor() or sensor("hdl64")

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights of a folder of results, if it is recorded."""
        stage = self._network_stage(folder)
        settings = self.settings(stage) if stage else None
        return settings.weights if isinstance(settings, WeightsSettings) else None

    def trained_on(self) -> RecordedScans:
        """Return the scans that the weights of the predictions were trained on."""
        stage = self._network_stage("predictions")
        settings = self.settings(stage) if stage else None
        if stage is None or not isinstance(settings, WeightsSettings):
            return NO_SCANS
        return recorded_scans(settings.trained_on or "", self.path(stage))

    def _network_stage(self, folder: str) -> str | None:
        """Return the stage that ran the network for a folder of results."""
        settings = self.settings_of(folder)
        # Without origins, an earlier version refined labels of another program.
        if isinstance(settings, RefineSettings) and settings.origins is not None:
            return self._network_stage("pixel_labels")
        return self.owner(folder)

    def require_same_weights(self) -> None:
        """Refuse an uncertainty of other weights or classes than the labels."""
        labels = self.weights("predictions")
        space = self.label_space("predictions")
        words = f"salsanext uncertainty SCANS {self.root}"
        sampled = self.settings("uncertainty")
        settings = [] if sampled is None else sampled.sampling_as_typed()
        hint = f"run `{command(words, *settings, setting('overwrite', True))}` with the"
        for folder in ("uncertainty/epistemic", ERROR):
            estimated = self.weights(folder)
            other = self.label_space(folder)
            if labels and estimated and labels != estimated:
                both = f"{labels[:12]}…, uncertainty of {estimated[:12]}…"
                problem = f"has labels of the weights {both}"
                hint = f"{hint} weights of the labels"
                raise OutputError(self.root, problem, "the same weights", hint)
            if labels and space and other and not space.fits(other):
                problem = f"has labels in the classes of {space.name}, uncertainty in {other.name}"
                hint = f"{hint} {argument('classes')} of the labels"
                raise OutputError(self.root, problem, "the same classes", hint)

    def rejected_above(self, folder: str = "predictions") -> float | None:
        """Return the uncertainty above which the run of a folder of results rejected points."""
        settings = self.settings_of(folder)
        return settings.reject if isinstance(settings, PredictSettings) else None

    def scans_of_threshold(self) -> RecordedScans:
        """Return the scans that `tune risk` chose the threshold of the predictions on."""
        stage = self.owner("predictions")
        record = self.record(stage) if stage else None
        if stage is None or record is None:
            return NO_SCANS
        return recorded_scans(digests_of_guarantee(record.settings), self.path(stage))

    def _recorded(self, value: Kind | None, name: str) -> Kind:
        """Return a setting that the record must contain."""
        if value is None:
            hint = "delete the record or use another folder"
            raise OutputError(self.root, f"has a record without {name}", hint=hint)
        return value


def require_same_settings(
    path: Path, recorded: Mapping[str, object], settings: Mapping[str, object]
) -> None:
    """Refuse to mix or to replace results of other settings, and name the differences."""
    changed = differences(with_names(recorded), with_names(settings))
    if changed:
        overwrite = setting("overwrite", True)
        hint = f"use another output folder, or {overwrite}, which first removes all its results"
        raise OutputError(path, f"was made with other settings: {changed}", hint=hint)
