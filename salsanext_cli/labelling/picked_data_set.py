# SPDX-License-Identifier: MIT
"""Data set of picked scans: its record, its files, and what a user changed in it."""

import hashlib
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import yaml

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError, OutputError, UsageError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import plain, read_record, write_json
from salsanext_cli.files.reading import filled, present, reading
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import encode_bin
from salsanext_cli.fusion.poses import CALIBRATION, POSES, line_numbers
from salsanext_cli.labelling.label_records import IMPORTED
from salsanext_cli.measures.scan_summary import ScanWarning
from salsanext_cli.results.manifest import require_same_settings, settings_json
from salsanext_cli.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.results.paths import SCAN_FOLDER, ScanFile, find_scans, output_path
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.version import __version__

STAGE = "pick"
LABEL_SPACE, TABLE = "labels.yaml", "picked.csv"
OLD_SHEET = "picked.png"  # Written by earlier versions

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PickedScan:
    """A picked scan, as record, table and JSON have it."""

    rank: int  # From 1, the scan most worth labelling
    sequence: str  # Its sequence and its name without suffix
    scan: str
    uncertainty: float  # Mean mutual information of its pixels, nats
    # Distance to the nearest scan picked before, 1 being that of two scans of the source (root mean
    # square); None for the first
    distance: float | None
    nearest: str | None  # That scan, as sequence/scan
    reason: str  # In words

    @property
    def name(self) -> str:
        """Sequence and scan."""
        return f"{self.sequence}/{self.scan}"


@dataclass(frozen=True, slots=True)
class PickSettings:
    """Settings that decide which scans are picked."""

    network: StageSettings
    count: int  # Number of scans to pick
    seed: int
    scans: str  # Number and digest of the scans to choose from
    labelled: str | None  # The same of those that are labelled already
    samples: int  # Monte-Carlo passes of a scan
    strategy: str = "both"  # Earlier versions had others

    def to_dict(self) -> dict[str, object]:
        """Return all settings in one table."""
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**plain(own.pop("network")), **own}


@dataclass(frozen=True, slots=True)
class PickRecord:
    """Record of a run of `pick`."""

    settings: dict[str, object]  # As `settings_json` returns them
    picked: list[PickedScan]  # In the order of their rank
    # `scan`, `reason` and `code` of each scan that could not be looked at
    failures: list[dict[str, str]]
    warnings: list[ScanWarning]  # Reasons to doubt scans
    # SHA-256 of the guessed labels that were written, by name of the scan
    guesses: dict[str, str] = field(default_factory=dict)
    stage: str = STAGE
    version: str = __version__


class ScanPaths(NamedTuple):
    """Files of a picked scan: `.bin`, `.label` and coloured `.ply`."""

    points: Path
    labels: Path
    cloud: Path


@dataclass(frozen=True, slots=True)
class PickedDataSet(OwnedFolder):
    """Folder of a data set of picked scans."""

    stage: str = STAGE

    def paths(self, sequence: str, stem: str) -> ScanPaths:
        """Return where the files of a scan lie."""
        cloud = output_path(self.root, sequence, "ply", stem)
        folder = cloud.parents[1]
        labels = folder / "labels" / f"{stem}.label"
        return ScanPaths(folder / SCAN_FOLDER / f"{stem}.bin", labels, cloud)

    def write_points(self, file: ScanFile, sensor: Sensor) -> None:
        """Write a scan as `.bin`, with the intensity of its file."""
        scan = read_scan(file.path, replace(sensor, intensity_scale=1.0))
        self.write_missing(self.paths(file.sequence, file.stem).points, encode_bin(scan))

    def write_guesses(self, record: PickRecord, labels: Mapping[ScanFile, bytes]) -> None:
        """Write the labels of scans that the network guessed, and record that they are guesses."""
        paths = {file: self.paths(file.sequence, file.stem).labels for file in labels}
        missing = {file: content for file, content in labels.items() if not filled(paths[file])}
        digests = {file.name: hashlib.sha256(missing[file]).hexdigest() for file in missing}
        guesses = dict(sorted({**record.guesses, **digests}.items()))
        # Recorded first: in a run that is cut off nothing passes for labels of a person.
        self._write_record(replace(record, guesses=guesses))
        for file, content in missing.items():
            self.write_missing(paths[file], content)

    def write_label_space(self, space: LabelSpace, picked: Iterable[PickedScan]) -> None:
        """Write the classes; all sequences are those for training."""
        sequences = tuple(sorted({each.sequence for each in picked}))
        splits: dict[str, tuple[str, ...]] = {"train": sequences, "valid": (), "test": ()}
        described = replace(space, splits=splits).to_dict()
        # Names of folders may be no text, which yaml can escape.
        text = yaml.safe_dump(described, sort_keys=False, allow_unicode=False)
        self.write_missing(self.root / LABEL_SPACE, text.encode())

    def write_poses(self, scans: Iterable[ScanFile]) -> None:
        """Write poses and calibration of the sequences of picked scans, where they are known."""
        ordered = sorted(scans)
        for name, group in groupby(ordered, lambda scan: scan.sequence):
            picked, folder = list(group), self.root / "sequences" / name
            source = picked[0].path.parent
            if source.name != SCAN_FOLDER:
                continue
            poses, calibration = source.with_name(POSES), source.with_name(CALIBRATION)
            try:
                if present(poses):
                    with reading(poses) as file:
                        lines = [*filter(None, map(bytes.strip, file.read().splitlines()))]
                    stems, wanted = (
                        [s.stem for s in each] for each in (find_scans(source), picked)
                    )
                    numbers, *others = line_numbers(poses, len(lines), stems, wanted)
                    if others:
                        found = "names of scans that count lines from 0 or from 1"
                        raise FormatError(poses, found, "a line for each scan")
                    chosen = b"".join(lines[number] + b"\n" for number in numbers)
                    self.write_missing(folder / POSES, chosen)
            except (FormatError, OutputError) as error:
                log.warning("%s; poses are left out", error)
            if present(calibration):
                with reading(calibration) as file:
                    self.write_missing(folder / CALIBRATION, file.read())

    def is_complete(self, record: PickRecord) -> bool:
        """Say whether all files are there, but for poses and calibration, which may be unknown."""
        return all(map(filled, self._certain_files(record)))

    def require_apart(self, scans: Iterable[ScanFile]) -> None:
        """Raise `UsageError` if the folder holds the scans to choose from."""
        out, folders = self.root.resolve(), {scan.path.parent.resolve() for scan in scans}
        if any(out in (folder, *folder.parents) for folder in folders):
            found = f"{self.root} holds the scans to choose from"
            raise UsageError("OUT", found, "another folder, for those that are picked")

    def earlier(self, settings: PickSettings, *, overwrite: bool) -> PickRecord | None:
        """Return the record of an earlier run with the same settings; None to begin anew."""
        self.require_new()
        record = self._record()
        if record and overwrite:
            self._require_unchanged(record)
            return None
        if record:
            require_same_settings(self.record_path, record.settings, settings_json(settings))
        return record

    def begin_anew(self, record: PickRecord) -> None:
        """Record what is picked; remove what an earlier run wrote."""
        if earlier := self._record():
            # Labels may have been corrected while the scans were looked at.
            self._require_unchanged(earlier)
            self.remove_written(self._files(earlier))
        self._write_record(record)

    def _record(self) -> PickRecord | None:
        return read_record(PickRecord, self.record_path)

    def _write_record(self, record: PickRecord) -> None:
        if record != self._record():
            write_json(self.record_path, record)

    def _certain_files(self, record: PickRecord) -> list[Path]:
        files = [self.root / name for name in (LABEL_SPACE, TABLE)]
        return files + [p for each in record.picked for p in self.paths(each.sequence, each.scan)]

    def _files(self, record: PickRecord) -> list[Path]:
        folders = sorted({self.root / "sequences" / each.sequence for each in record.picked})
        uncertain = [folder / name for folder in folders for name in (POSES, CALIBRATION)]
        return [*self._certain_files(record), *uncertain, self.root / OLD_SHEET]

    def _require_unchanged(self, record: PickRecord) -> None:
        """Refuse to replace files that are not as `pick` wrote them, and imported labels."""
        if imports := [path for path in map(self.root.joinpath, IMPORTED) if present(path)]:
            found = "says that labels were imported, which are kept"
            raise OutputError(imports[0], found, hint="choose another folder")
        self.refuse_foreign(self._files(record))
        for each in record.picked:
            labels = self.paths(each.sequence, each.scan).labels
            guess = record.guesses.get(each.name)
            # Other commands write labels too, and those are no guesses any more.
            if guess and present(labels) and fingerprint(labels) != guess:
                raise foreign_file(labels)
