# SPDX-License-Identifier: MIT
"""Records of stages in an output folder, ``OUT/<stage>.json``: settings, results and scans."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging, contradiction
from salsanext_cli.errors import LabelError, OutputError, first_few, shortened
from salsanext_cli.files.identity import identity
from salsanext_cli.files.json_files import RecordedSettings, read_json, write_json
from salsanext_cli.formats import scan_suffix
from salsanext_cli.network.card import parted
from salsanext_cli.results.layout import COLOURINGS, ERROR, SUFFIX_OF_FOLDER, ScanFile
from salsanext_cli.results.selection import space_of
from salsanext_cli.sensors.sensor import Sensor, sensor
from salsanext_cli.version import __version__

MAX_PATH_CHARACTERS = 500
RESULT_STAGES = (
    *("project", "predict", "knn-refine", "uncertainty", "fuse", "picture", "export-ply"),
    *(f"export-ply-{colour}" for colour in COLOURINGS),
)


@dataclass(frozen=True, slots=True)
class ScanSource:
    """Scans of one sequence that a stage worked on."""

    folder: str  # Where they lie, absolute
    # Suffixes of the files by stem, of those that the stage was asked for in any of its runs, done
    # or failed; empty for scans of a recording, and in older records
    suffixes: dict[str, str]

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> "ScanSource":
        """Read the entry of a sequence; anything amiss raises a `TypeError` or the like."""
        folder, names = entry["folder"], entry["asked_for"]
        if not isinstance(names, list) or "\0" in folder:
            raise TypeError
        if not all(isinstance(text, str) for text in (folder, *names)):
            raise TypeError
        lengths = (len(name) - len(scan_suffix(name)) for name in names)
        return cls(folder, {n[:end]: n[end:] for n, end in zip(names, lengths, strict=True)})


def merged_sources(several: Iterable[Mapping[str, ScanSource]]) -> dict[str, ScanSource]:
    """Return all files of each sequence."""
    merged: dict[str, ScanSource] = {}
    for name, source in chain.from_iterable(each.items() for each in several):
        known = merged.get(name, source).suffixes
        told = {stem: suffix or known.get(stem, "") for stem, suffix in source.suffixes.items()}
        merged[name] = ScanSource(source.folder, known | told)
    return merged


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
            name: {"folder": each.folder, "asked_for": sorted(map("".join, each.suffixes.items()))}
            for name, each in sorted(self.scans.items())
        }
        written = {"stage": self.stage, "version": __version__, "settings": self.settings}
        record = written | {"writes": list(self.folders), "scans": scans}
        return record | ({"kept": sorted(self.kept)} if self.kept else {})

    def write(self, out: Path) -> None:
        """Write the record into an output folder, durably."""
        write_json(out / f"{self.stage}.json", self.to_dict())


@lru_cache(4 * len(RESULT_STAGES))  # Of some folders
def _read_record(path: Path, stage: str, _: tuple[object, ...]) -> StageRecord | None:
    content = read_json(path)
    if content is None:
        return None
    try:
        settings, folders = content["settings"], tuple(content["writes"])
        if not isinstance(settings, dict) or not all(f in SUFFIX_OF_FOLDER for f in folders):
            raise TypeError
        sources = content.get("scans", {}).items()
        scans = {name: ScanSource.from_dict(source) for name, source in sources}
        kept = frozenset(content.get("kept", ()))
        if not all(isinstance(path, str) for path in kept):
            raise TypeError
        return StageRecord(stage, settings, folders, scans, kept)
    except (TypeError, KeyError, AttributeError) as error:
        remedy = "delete it or use another folder"
        raise OutputError(path, f"not what `{stage}` writes", remedy=remedy) from error


class Rejection(NamedTuple):
    """Rule by which a run left points unlabelled."""

    above: float  # Points above it are unlabelled; classes may have thresholds of their own
    chosen_on: frozenset[str]  # Digests of the scans that `tune risk` chose it on


@dataclass(frozen=True, slots=True)
class StageRecords:
    """Records of the stages that ran in an output folder, read when they are asked for."""

    root: Path

    def record(self, stage: str) -> StageRecord | None:
        """Return the record of a stage, shared by all that ask; None if it did not run here."""
        path = self.root / f"{stage}.json"
        return _read_record(path, stage, identity(path))

    def records(self) -> dict[str, StageRecord]:
        """Read the records of all stages that ran here, by stage."""
        records = {stage: self.record(stage) for stage in RESULT_STAGES}
        return {stage: record for stage, record in records.items() if record is not None}

    def sources(self) -> dict[str, ScanSource]:
        """Return where the scans of all stages came from, by sequence."""
        return merged_sources(record.scans for record in self.records().values())

    def settings(self, stage: str) -> RecordedSettings | None:
        """Return the settings a stage ran with, None if it did not."""
        record = self.record(stage)
        path = self.root / f"{stage}.json"
        return RecordedSettings(record.settings, path) if record else None

    def owner(self, folder: str) -> str | None:
        """Return the stage that writes a folder of results, if any does."""
        records = self.records()
        return next((stage for stage, record in records.items() if folder in record.folders), None)

    def settings_of(self, *folders: str) -> RecordedSettings | None:
        """Return the settings behind the first of some folders of results that a stage recorded."""
        stages = map(self.owner, folders)
        return next((self.settings(stage) for stage in stages if stage), None)

    def origins(self, stages: Iterable[str]) -> dict[str, str]:
        """Return a digest of the settings of each of the stages that ran, for later records."""
        records = filter(None, map(self.record, stages))
        texts = {each.stage: json.dumps(each.settings, sort_keys=True) for each in records}
        return {s: hashlib.sha256(text.encode()).hexdigest()[:12] for s, text in texts.items()}

    def label_space(self, *folders: str) -> LabelSpace | None:
        """Return the classes of the first folder that a stage fills, of predictions by default."""
        settings = self.settings_of(*(folders or ("predictions", "pixel_labels")))
        if not settings:
            return None
        return LabelSpace.from_dict(settings.table("label_space"), settings.path)

    def compared_space(
        self,
        scans: Sequence[ScanFile],
        space: LabelSpace | None = None,
        classes: LabelSpace | None = None,
        *,
        own_ids: bool = False,
    ) -> LabelSpace:
        """Return the classes in which predictions and labels are compared, with the labels' splits.

        They are those of both, or those of the predictions if these are merged ones of the labels',
        or `classes`, into which both are merged. `space`: of the labels, if not the data set's;
        `own_ids`: whether labels may have other raw ids for classes of the same names.
        """
        recorded = self.label_space()
        space = space or space_of(scans, recorded)
        target = classes or recorded or space
        named_alike = own_ids and space.names == target.names
        if classes is not None:
            for own in (recorded or space, *(() if named_alike else (space,))):
                ClassMerging.needed(own, classes)
        elif target.fits(space):
            return space
        elif not named_alike and contradiction(space, target):
            named = first_few(target.differences(space))
            found = f"predictions in the classes of {target.name} ({named})"
            remedy = "predict with weights for these classes, or merge both with --classes"
            raise LabelError(self.root, found, f"those of {space.name}, as the labels", remedy)
        return replace(target, splits=space.splits or (classes or space).splits)

    def merging_into(self, space: LabelSpace) -> ClassMerging | None:
        """Return the merging of the classes of the probabilities into others, if one is needed."""
        own = self.label_space("probabilities")
        return None if own is None or own.fits(space) else ClassMerging.between(own, space)

    def promised(self, space: LabelSpace) -> Mapping[str, Any] | None:
        """Return what `tune risk` promised of the labels, if these classes are those it knew."""
        own, recorded = self.label_space("predictions"), self.settings_of("predictions")
        return recorded.get("promised") if recorded and own and own.fits(space) else None

    def known_sensor(self) -> Sensor | None:
        """Return the sensor that results were made through, if one is recorded."""
        folders = ("pixel_labels", "predictions", "uncertainty/epistemic", "range")
        return recorded_sensor(self.settings_of(*folders))

    def sensor(self) -> Sensor:
        """Return the sensor that labels were made through; else the HDL-64."""
        return self.known_sensor() or sensor("hdl64")

    def weights(self, folder: str) -> str | None:
        """Return the SHA-256 of the weights behind a folder of results, if one is recorded."""
        settings = self._settings_of_network(folder)
        digest = settings.get("weights")
        return None if digest is None else str(digest)

    def trained_on(self) -> frozenset[str]:
        """Return the digests of the scans that the weights of the predictions were trained on."""
        return self._digests(self._settings_of_network("predictions"), "trained_on")

    def _digests(self, settings: Mapping[str, Any], key: str) -> frozenset[str]:
        try:
            return frozenset(parted(settings.get(key, "")))
        except ValueError as error:
            found = f"its record holds {error} under {key}"
            raise OutputError(self.root, found, remedy="use another folder") from error

    def _settings_of_network(self, folder: str) -> Mapping[str, Any]:
        """Return the settings of the stage that computed what a folder of results is made of."""
        settings: Mapping[str, Any] = self.settings_of(folder) or {}
        if self.owner(folder) == "knn-refine" and settings.get("labels") is None:
            return self._settings_of_network("pixel_labels")
        return settings

    def require_same_weights(self) -> None:
        """Refuse to show the uncertainty of one network, or in other classes, beside the labels."""
        labels, space = self.weights("predictions"), self.label_space("predictions")
        remedy = f"run `salsanext uncertainty SCANS {self.root} --overwrite` with the"
        for folder in ("uncertainty/epistemic", ERROR):
            estimated, other = self.weights(folder), self.label_space(folder)
            if labels and estimated and labels != estimated:
                found = f"labels by the weights {labels[:12]}…, uncertainty by {estimated[:12]}…"
                expected, remedy = "the same weights for both", f"{remedy} weights of the labels"
                raise OutputError(self.root, found, expected, remedy)
            if labels and space and other and not space.fits(other):
                classes = f"the classes of {space.name}, uncertainty in those of {other.name}"
                remedy = f"{remedy} --classes of the labels"
                raise OutputError(self.root, f"labels in {classes}", "the same for both", remedy)

    def rejection(self, folder: str = "predictions") -> Rejection | None:
        """Return by what points were left unlabelled; `folder`: of results of the same run."""
        settings: Mapping[str, Any] = self.settings_of(folder) or {}
        above = settings.get("reject")
        if above is None:
            return None
        chosen_on = self._digests(settings.get("promised", {}), "digests")
        return Rejection(above, chosen_on)


def recorded_sensor(settings: RecordedSettings | None) -> Sensor | None:
    """Return the sensor in the settings of a stage, None without any."""
    return None if settings is None else Sensor.from_dict(settings.table("sensor"), settings.path)


def as_json(settings: Any) -> Any:
    """Return settings as they are read back: lists for tuples, strings for keys and infinity."""
    return json.loads(json.dumps(settings), parse_constant=str)


def require_same_settings(
    path: Path, recorded: Mapping[str, Any], settings: Mapping[str, Any]
) -> None:
    """Refuse to mix or to replace what was made with other settings, and say which."""
    if recorded != settings:
        remedy = "use another output folder, or --overwrite to replace all its results"
        found = f"made with other settings: {differences(recorded, settings)}"
        raise OutputError(path, found, remedy=remedy)


def differences(recorded: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """Say how settings that were recorded differ from others, empty if they do not."""
    before, after = _flat(recorded), _flat(settings)
    changed = sorted(k for k in before.keys() | after if before.get(k) != after.get(k))
    return first_few([_difference(k, before.get(k), after.get(k)) for k in changed])


def _difference(key: str, before: Any, after: Any) -> str:
    """Say how a setting differs; of lists of one length, name the first value that does."""
    if key == "sensor.intensity_quantiles":
        was, now = _intensity(before), _intensity(after)
        now = "matched to other scans" if now == was else now
        return f"intensity was {was} and is {now} (--intensity)"
    if key.startswith("origins."):
        return f"what `{key.removeprefix('origins.')}` made was made anew"
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
