# SPDX-License-Identifier: MIT
"""Records of stages in an output folder, ``OUT/<stage>.json``: settings, results and scans."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import OutputError, first_few, shortened
from salsanext_cli.files.json_files import RecordedSettings, read_json, write_json
from salsanext_cli.network.card import parted
from salsanext_cli.results.layout import COLOURINGS, SUFFIX_OF_FOLDER
from salsanext_cli.sensors.sensor import Sensor, sensor
from salsanext_cli.version import __version__

SHOWN_CHARACTERS_OF_VALUE = 40
RESULT_STAGES = (
    *("project", "predict", "knn-refine", "uncertainty", "picture", "export-ply"),
    *(f"export-ply-{colour}" for colour in COLOURINGS),
)


@dataclass(frozen=True, slots=True)
class ScanSource:
    """Scans of one sequence that a stage worked on."""

    folder: str  # Where they lie, absolute
    stems: frozenset[str]  # Those that the stage was asked for in any of its runs, done or failed


@dataclass(frozen=True, slots=True)
class StageRecord:
    """Record of the runs of a stage, all with the same settings."""

    stage: str  # Its name on the command line
    # Resolved settings that decide what the results are, as JSON gives them back
    settings: dict[str, Any]
    # Folders of results that the stage fills, keys of `SUFFIX_OF_FOLDER`
    folders: tuple[str, ...] = ()
    # By sequence; empty for a stage that works on what earlier ones recorded
    scans: dict[str, ScanSource] = field(default_factory=dict)
    # Results of other settings or origin that were not removed, as paths below the folder
    kept: frozenset[str] = frozenset()

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the record's file."""
        scans = {
            sequence: {"folder": source.folder, "asked_for": sorted(source.stems)}
            for sequence, source in sorted(self.scans.items())
        }
        written = {"stage": self.stage, "version": __version__, "settings": self.settings}
        record = written | {"writes": list(self.folders), "scans": scans}
        if self.kept:
            record["kept"] = sorted(self.kept)
        return record

    def write(self, out: Path) -> None:
        """Write the record into an output folder, durably."""
        write_json(out / f"{self.stage}.json", self.to_dict())


def _scan_source(entry: dict[str, Any]) -> ScanSource:
    folder, stems = entry["folder"], entry["asked_for"]
    if not isinstance(folder, str) or "\0" in folder or not isinstance(stems, list):
        raise TypeError
    if not all(isinstance(stem, str) for stem in stems):
        raise TypeError
    return ScanSource(folder, frozenset(stems))


@dataclass(frozen=True, slots=True)
class StageRecords:
    """Records of the stages that ran in an output folder, read when they are asked for."""

    root: Path

    def record(self, stage: str) -> StageRecord | None:
        """Read the record of a stage, None if it did not run here."""
        path = self.root / f"{stage}.json"
        content = read_json(path)
        if content is None:
            return None
        try:
            settings, folders = content["settings"], tuple(content["writes"])
            if not isinstance(settings, dict) or not all(f in SUFFIX_OF_FOLDER for f in folders):
                raise TypeError
            scans = {name: _scan_source(each) for name, each in content.get("scans", {}).items()}
            paths = (self.root.joinpath(name) for name in content.get("kept", ()))
            kept = frozenset(path.relative_to(self.root).as_posix() for path in paths)
            return StageRecord(stage, settings, folders, scans, kept)
        except (TypeError, KeyError, AttributeError) as error:
            remedy = "delete it or use another folder"
            raise OutputError(path, f"not what `{stage}` writes", remedy=remedy) from error

    def records(self) -> dict[str, StageRecord]:
        """Read the records of all stages that ran here, by stage."""
        records = {stage: self.record(stage) for stage in RESULT_STAGES}
        return {stage: record for stage, record in records.items() if record is not None}

    def settings(self, stage: str) -> RecordedSettings | None:
        """Return the settings a stage ran with, None if it did not."""
        record = self.record(stage)
        path = self.root / f"{stage}.json"
        return RecordedSettings(record.settings, path) if record else None

    def owner(self, folder: str) -> str | None:
        """Return the stage that writes a folder of results, if any does."""
        records = self.records()
        return next((stage for stage, record in records.items() if folder in record.folders), None)

    def settings_of(self, folder: str) -> RecordedSettings | None:
        """Return the settings behind a folder of results, None if no stage recorded them."""
        stage = self.owner(folder)
        return self.settings(stage) if stage else None

    def origins(self, stages: Iterable[str]) -> dict[str, str]:
        """Return a digest of the settings of each of the stages that ran here.

        A stage that reads their results records it, so as not to keep what it made of older ones.
        """
        settings = {stage: self.settings(stage) for stage in stages}
        return {
            stage: hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]
            for stage, values in settings.items()
            if values is not None
        }

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first of the folders that a stage fills, else None.

        It is of the predictions by default.
        """
        of_folders = map(self.settings_of, folders or ("predictions", "pixel_labels"))
        settings = next((each for each in of_folders if each), None)
        if settings is None:
            return None
        return LabelSpace.from_dict(settings.table("label_space"), settings.path)

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights behind a folder of results, if one is recorded.

        Of weights that were adapted to the scans, it is that of the adapted ones.
        """
        settings = self._settings_of_network(folder)
        digest = settings.get("adapted", settings.get("weights"))
        return None if digest is None else str(digest)

    def trained_on(self) -> frozenset[str]:
        """Return the digests of the scans that the weights of the predictions were trained on."""
        try:
            recorded = self._settings_of_network("predictions").get("trained_on", "")
            return frozenset(parted(recorded))
        except ValueError as error:
            found = f"its record holds {error} under trained_on"
            raise OutputError(self.root, found, remedy="use another folder") from error

    def _settings_of_network(self, folder: str) -> Mapping[str, Any]:
        """Return the settings of the stage that computed what a folder of results is made of."""
        settings: Mapping[str, Any] = self.settings_of(folder) or {}
        if self.owner(folder) == "knn-refine" and settings.get("labels") is None:
            return self._settings_of_network("pixel_labels")
        return settings

    def sensor(self) -> Sensor:
        """Return the sensor that labels were made through; else the HDL-64."""
        return self.known_sensor() or sensor("hdl64")

    def known_sensor(self) -> Sensor | None:
        """Return the sensor that results were made through, if one is recorded."""
        for folder in ("pixel_labels", "predictions", "uncertainty/epistemic", "range"):
            if (settings := self.settings_of(folder)) is not None:
                return Sensor.from_dict(settings.table("sensor"), settings.path)
        return None

    def settings_with(self, weights: str | None) -> RecordedSettings | None:
        """Return the settings of labels or uncertainties made with these weights, if any."""
        for stage in ("predict", "uncertainty"):
            settings = self.settings(stage)
            if settings is not None and settings.get("weights") == weights:
                return settings
        return None


def as_json(settings: Any) -> Any:
    """Return settings as they are read back: lists for tuples, strings for keys."""
    # JSON has no number for an infinite cutoff.
    return json.loads(json.dumps(settings), parse_constant=str)


def require_same_settings(
    path: Path, recorded: Mapping[str, Any], settings: Mapping[str, Any]
) -> None:
    """Refuse to mix or to replace what was made with other settings, and say which."""
    if recorded != settings:
        found = f"made with other settings: {_differences(recorded, settings)}"
        remedy = "use another output folder, or --overwrite to replace all its results"
        raise OutputError(path, found, remedy=remedy)


def _differences(recorded: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """Name what differs, key by key, and how."""
    before, after = _flat(recorded), _flat(settings)
    changed = sorted(k for k in before.keys() | after if before.get(k) != after.get(k))
    shown = [_difference(key, before.get(key), after.get(key)) for key in changed]
    return first_few(shown)


def _difference(key: str, before: Any, after: Any) -> str:
    """Say how a setting differs.

    Origins are named without their digests, label spaces by their classes, long lists by the
    first value that differs, or their length.
    """
    if key == "sensor.intensity_quantiles":
        was, now = _intensity(before), _intensity(after)
        now = "matched to other scans" if now == was else now
        return f"intensity was {was} and is {now} (--intensity)"
    if key.startswith("origins."):
        return f"what `{key.removeprefix('origins.')}` made was made anew"
    if isinstance(before, dict) and isinstance(after, dict):
        old, new = (LabelSpace.from_dict(space, key) for space in (before, after))
        return f"{key} ({first_few(old.differences(new))})"
    lists = isinstance(before, list) and isinstance(after, list) and len(before) == len(after)
    if lists and len(json.dumps(before)) > SHOWN_CHARACTERS_OF_VALUE:
        pairs = enumerate(zip(before, after, strict=True))
        place, (before, after) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        key = f"{key}[{place}]"
    return f"{key} was {_as_shown(before)} and is {_as_shown(after)}"


def _intensity(quantiles: Sequence[float] | None) -> str:
    """Say how intensity is used with such quantiles of a sensor, which may not be set."""
    if not quantiles:
        return "raw"
    return "matched" if any(quantiles) else "none"


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by dotted key; a label space stays whole."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        nested = isinstance(value, dict) and key != "label_space"
        flat |= _flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return flat


def _as_shown(value: object) -> str:
    if value is None:
        return "not set"
    if isinstance(value, list) and len(json.dumps(value)) > SHOWN_CHARACTERS_OF_VALUE:
        return f"{len(value)} values ({json.dumps(value[0])} to {json.dumps(value[-1])})"
    return shortened(json.dumps(value, ensure_ascii=False), SHOWN_CHARACTERS_OF_VALUE)
