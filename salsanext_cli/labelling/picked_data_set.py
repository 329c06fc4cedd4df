# SPDX-License-Identifier: MIT
"""Data set of picked scans: its record, its files, and what a user changed in it."""

import hashlib
import logging
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError, OutputError, UsageError
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.reading import filled, present, reading
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import encode_bin
from salsanext_cli.fusion.poses import CALIBRATION, POSES, line_numbers
from salsanext_cli.labelling.label_records import IMPORTED
from salsanext_cli.results.layout import SCAN_FOLDER, ScanFile, find_scans, output_path
from salsanext_cli.results.owned_folder import OwnedFolder, not_own
from salsanext_cli.results.stage_records import require_same_settings
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.version import __version__

STAGE = "pick"
LABEL_SPACE, TABLE, SHEET = "labels.yaml", "picked.csv", "picked.png"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PickedScan:
    """A picked scan, as record, table and JSON have it."""

    rank: int  # From 1, the scan most worth labelling
    sequence: str  # Its sequence and its name without suffix
    scan: str
    uncertainty: float  # Mean mutual information of its pixels, nats, or mean disagreement
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
class PickRecord:
    """Record of a run of `pick`."""

    # Resolved settings that decide what is picked, as JSON gives them back
    settings: dict[str, Any]
    picked: list[PickedScan]  # In the order of their rank
    # `scan`, `reason` and `code` of each scan that could not be looked at
    failures: list[dict[str, str]]
    warnings: list[dict[str, Any]]  # Reasons to doubt scans, as `RunSummary.warnings` lists them
    # SHA-256 of the guessed labels that were written, by name of the scan
    guesses: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the record's file."""
        return {"stage": STAGE, "version": __version__, **asdict(self)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], path: Path) -> "PickRecord":
        """Read what `to_dict` returned from a file; `OutputError` if it is something else."""
        try:
            picked = [PickedScan(**row) for row in data["picked"]]
            failures, warnings = data["failures"], data["warnings"]
            return cls(data["settings"], picked, failures, warnings, data["guesses"])
        except (TypeError, KeyError) as error:
            remedy = "delete it or use another folder"
            raise OutputError(path, f"not what `{STAGE}` writes", remedy=remedy) from error


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
        self.begin(replace(record, guesses=guesses).to_dict())
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

    def earlier(self, settings: Mapping[str, Any], *, overwrite: bool) -> PickRecord | None:
        """Return the record of an earlier run with the same settings; None to begin anew."""
        self.require_new()
        record = self._record()
        if record and overwrite:
            self._require_unchanged(record)
            return None
        if record:
            require_same_settings(self.record_path, record.settings, settings)
        return record

    def begin_anew(self, record: PickRecord) -> None:
        """Record what is picked; remove what an earlier run wrote."""
        if earlier := self._record():
            # Labels may have been corrected while the scans were looked at.
            self._require_unchanged(earlier)
        self.begin(record.to_dict(), self._files(earlier) if earlier else [])

    def _record(self) -> PickRecord | None:
        data = self.recorded()
        return None if data is None else PickRecord.from_dict(data, self.record_path)

    def _certain_files(self, record: PickRecord) -> list[Path]:
        files = [self.root / name for name in (LABEL_SPACE, TABLE, SHEET)]
        return files + [p for each in record.picked for p in self.paths(each.sequence, each.scan)]

    def _files(self, record: PickRecord) -> list[Path]:
        folders = sorted({self.root / "sequences" / each.sequence for each in record.picked})
        uncertain = [folder / name for folder in folders for name in (POSES, CALIBRATION)]
        return self._certain_files(record) + uncertain

    def _require_unchanged(self, record: PickRecord) -> None:
        """Refuse to replace files that are not as `pick` wrote them, and imported labels."""
        if present(self.root / IMPORTED):
            found = "says that labels were imported, which are kept"
            raise OutputError(self.root / IMPORTED, found, remedy="choose another folder")
        self.require_own(self._files(record))
        for each in record.picked:
            labels = self.paths(each.sequence, each.scan).labels
            guess = record.guesses.get(each.name)
            # Other commands write labels too, and those are no guesses any more.
            if guess and present(labels) and fingerprint(labels) != guess:
                raise not_own(labels)
