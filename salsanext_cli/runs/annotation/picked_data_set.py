# SPDX-License-Identifier: MIT
"""Data set of picked scans: its record and its files, which the user may edit."""

import hashlib
import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import yaml

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import FormatError, OutputError, UsageError
from salsanext_cli.core.poses import CALIBRATION, POSES
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.json_files import read_json, record_of, write_json
from salsanext_cli.io.files.reading import filled, fingerprint, present, reading
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES
from salsanext_cli.io.poses import line_numbers
from salsanext_cli.runs.annotation.label_records import IMPORTED
from salsanext_cli.runs.annotation.map_frames import (
    ChangedFrames,
    frame_of,
    missing_frames,
    refuse_lost_frames,
    write_frames,
)
from salsanext_cli.runs.annotation.picked_frames import (
    PickedFrames,
    origins_of,
    sequences_without_file,
)
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.results.manifest import require_same_settings, settings_json
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder, foreign_file
from salsanext_cli.runs.scans.layouts import SCAN_FOLDER, TOOL_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.version import __version__

STAGE = "pick"
LABEL_SPACE = "labels.yaml"
TABLE = "picked.csv"
PREDICTED = "predicted"  # Folder of the results of the picked scans, for `report` and `eval`
CHOSEN = "both"  # Strategy that picks scans by uncertainty and distance
NAMED = "named"  # Strategy that picks the scans of a list

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PickedScan:
    """A picked scan in record, table and JSON."""

    rank: int  # From 1, the scan most worth labelling
    sequence: str
    scan: str  # Stem of its file
    uncertainty: float  # Mean mutual information of its pixels, nats
    distance: float | None  # To the nearest earlier scan; 1 is the RMS distance between two scans
    nearest: str | None  # That scan, as sequence/scan
    reason: str  # In words

    @property
    def name(self) -> str:
        """Sequence and scan."""
        return f"{self.sequence}/{self.scan}"


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyScale:
    """Uncertainties of all scans of a choice, to compare those of the picked scans with."""

    least: float  # Mean mutual information of the pixels of a scan, nats, as all three
    median: float
    most: float
    class_count: int  # The mutual information is at most its logarithm


@dataclass(frozen=True, slots=True, kw_only=True)
class PickSettings:
    """Settings of the choice of scans."""

    network: ComputedSettings
    count: int  # Number of scans to pick
    seed: int
    scans: str  # Number and digest of the scans to choose from
    labelled: str | None  # The same of scans that are already labelled
    samples: int  # Monte-Carlo passes of a scan
    strategy: str = CHOSEN  # Or `NAMED`; earlier versions had others

    def to_dict(self) -> dict[str, object]:
        """Return all settings in one table, those of the network among them."""
        network = self.network.to_dict()
        trained_on = network.pop("trained_on")
        return {
            **network,
            "samples": self.samples,
            "seed": self.seed,
            "trained_on": trained_on,
            "count": self.count,
            "scans": self.scans,
            "labelled": self.labelled,
            "strategy": self.strategy,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class PickRecord:
    """Record of a run of `pick`."""

    settings: dict[str, object]  # From `settings_json`
    picked: list[PickedScan]  # In the order of their rank
    failures: list[dict[str, str]]  # `scan`, `reason`, `hint` and `code` of unreadable scans
    warnings: list[ScanWarning]
    pre_labels: dict[str, str] = field(default_factory=dict)  # SHA-256 by name of the scan
    scale: UncertaintyScale | None = None  # None in records of earlier versions
    frames: PickedFrames | None = None  # None in records of earlier versions
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
        """Return the paths of the files of a scan."""
        cloud = output_path(self.root, sequence, "ply", stem)
        folder = cloud.parents[1]
        labels = folder / "labels" / f"{stem}.label"
        return ScanPaths(folder / SCAN_FOLDER / f"{stem}.bin", labels, cloud)

    def write_points(
        self,
        file: ScanFile,
        sensor: Sensor,
        beside: Mapping[ScanFile, Origin],
        recorded: Origin | None,
    ) -> None:
        """Write a scan as `.bin`, with the intensity in its file.

        Parameters
        ----------
        file : ScanFile
            The scan.
        sensor : Sensor
            Its sensor.
        beside : mapping of ScanFile to tuple of float
            Frames by `frames_beside`, metres.
        recorded : tuple of float, optional
            Frame of the scan in the record of the run, metres; None if it could not be read for it.

        Raises
        ------
        FormatError
            If the scan has another frame now, so that its points would be elsewhere in the map, or
            none is recorded.
        """
        if recorded is None:
            problem = "could not be read when the frames of picked scans were recorded"
            raise FormatError(file.path, problem, hint="run the same command again")
        scan = read_scan(file.path, replace(sensor, intensity_scale=1.0))
        if frame_of(file, scan, beside) != recorded:
            problem = "has another frame in map coordinates than when it was picked"
            hint = f"restore the scan and its {FRAMES}, or pick into another folder"
            raise FormatError(file.path, problem, hint=hint)
        self.write_missing(self.paths(file.sequence, file.stem).points, encode_bin(scan))

    def restore_frames(self, record: PickRecord) -> None:
        """Write the recorded frames that `lost_frames` returns."""
        write_frames(self, self.lost_frames(record))

    def lost_frames(self, record: PickRecord) -> list[ChangedFrames]:
        """Return the files beside the picked scans that lack recorded frames.

        Raises
        ------
        OutputError
            If the user edited such a file.
        """
        copies = [
            ScanFile(
                sequence=scan.sequence,
                stem=scan.scan,
                path=self.paths(scan.sequence, scan.scan).points,
            )
            for scan in record.picked
        ]
        return missing_frames(self, origins_of(record.frames or {}, copies))

    def record_frames(self, record: PickRecord, frames: PickedFrames) -> PickRecord:
        """Add the frames of picked scans to a record of an earlier version; return it."""
        record = replace(record, frames=frames)
        self._write_record(record)
        self.restore_frames(record)
        return record

    def write_pre_labels(self, record: PickRecord, labels: Mapping[ScanFile, bytes]) -> None:
        """Write the record with the pre-labels of scans, and those that are missing."""
        paths = {file: self.paths(file.sequence, file.stem).labels for file in labels}
        missing = {file: content for file, content in labels.items() if not filled(paths[file])}
        digests = {file.name: hashlib.sha256(missing[file]).hexdigest() for file in missing}
        pre_labels = dict(sorted({**record.pre_labels, **digests}.items()))
        # Recorded first: an interrupted run must not leave labels that look like a person's.
        self._write_record(replace(record, pre_labels=pre_labels))
        for file, content in missing.items():
            self.write_missing(paths[file], content)

    def write_label_space(self, space: LabelSpace, picked: Iterable[PickedScan]) -> None:
        """Write the classes; all sequences are in the split `train`."""
        sequences = tuple(sorted({scan.sequence for scan in picked}))
        splits: dict[str, tuple[str, ...]] = {"train": sequences, "valid": (), "test": ()}
        described = replace(space, splits=splits).to_dict()
        # Names of folders may not be text, which yaml escapes.
        text = yaml.safe_dump(described, sort_keys=False, allow_unicode=False)
        self.write_missing(self.root / LABEL_SPACE, text.encode())

    def write_poses(self, frames: Mapping[ScanFile, Origin]) -> None:
        """Write poses and calibration of the sequences of picked scans, if known.

        `frames` holds the frame of the points of each picked scan. Poses of scans in map
        coordinates are in these coordinates, and skipped.
        """
        ordered = sorted(frames)
        for name, group in groupby(ordered, lambda scan: scan.sequence):
            picked = list(group)
            folder = self.root / "sequences" / name
            source = picked[0].path.parent
            poses = source.with_name(POSES)
            if any(frames[scan] != NO_SHIFT for scan in picked):
                if present(poses):
                    log.warning("%s: is in map coordinates, and skipped", poses)
                continue
            if source.name != SCAN_FOLDER:
                continue
            calibration = source.with_name(CALIBRATION)
            try:
                if present(poses):
                    with reading(poses) as file:
                        lines = [*filter(None, map(bytes.strip, file.read().splitlines()))]
                    stems = [scan.stem for scan in find_scans(source)]
                    picked_stems = [scan.stem for scan in picked]
                    numbers, *others = line_numbers(poses, len(lines), stems, picked_stems)
                    if others:
                        problem = "has lines that scans may number from 0 or from 1"
                        raise FormatError(poses, problem, "a line for each scan")
                    chosen = b"".join(lines[number] + b"\n" for number in numbers)
                    self.write_missing(folder / POSES, chosen)
            except (FormatError, OutputError) as error:
                log.warning("%s: poses are skipped", error.headline)
            if present(calibration):
                with reading(calibration) as file:
                    self.write_missing(folder / CALIBRATION, file.read())

    def is_complete(self, record: PickRecord) -> bool:
        """Return whether all files exist that `restore_frames` does not write, and all frames.

        Poses and calibration may be unknown. The frame of a scan is missing in the record of an
        earlier version whose scan could not be read again.
        """
        files = self._certain_files(record)
        if record.frames is None:
            files += self._unrecorded_frames(record)
        elif any(scan.name not in record.frames for scan in record.picked):
            return False
        return all(map(filled, files))

    def refuse_lost_frames(self, scans: Iterable[ScanFile]) -> None:
        """Refuse scans whose earlier copies have frames of a file that is ignored now.

        Parameters
        ----------
        scans : iterable of ScanFile
            Scans that may take the place of the earlier ones.

        Raises
        ------
        FormatError
            If another program wrote a file with the name of frames.
        """
        record = self._record()
        frames = (record.frames if record else None) or {}
        without_file = sequences_without_file(frames)
        refuse_lost_frames(self, [scan for scan in scans if scan.sequence not in without_file])

    def require_apart(self, scans: Iterable[ScanFile]) -> None:
        """Raise `UsageError` if the folder holds the scans to choose from."""
        out = self.root.resolve()
        folders = {scan.path.parent.resolve() for scan in scans}
        if any(out in (folder, *folder.parents) for folder in folders):
            problem = f"{self.root} contains the scans to choose from"
            raise UsageError("OUT", problem, "another folder, for the picked scans")

    def earlier(self, settings: PickSettings, *, overwrite: bool) -> PickRecord | None:
        """Return the record of an earlier run with the same settings; None for a new pick."""
        self.require_new()
        record = self._record()
        if record and overwrite:
            self._require_unchanged(record)
            return None
        if record:
            require_same_settings(self.record_path, record.settings, settings_json(settings))
        return record

    def begin(self, record: PickRecord) -> None:
        """Record the picked scans, and write their frames; remove the files of an earlier run."""
        earlier = self._record()
        if earlier:
            # The user may have corrected labels in the meantime.
            self._require_unchanged(earlier)
            self.remove_written(self._files(earlier))
        self._write_record(record)
        # Before their points, which are local ones without the frames.
        self.restore_frames(record)

    def _record(self) -> PickRecord | None:
        data = read_json(self.record_path)
        if data is None:
            return None
        # Older versions had other keys.
        warnings = [{"hint": w.get("remedy", ""), **w} for w in data.get("warnings", ())]
        data = {"pre_labels": data.get("guesses", {}), **data, "warnings": warnings}
        return record_of(PickRecord, data, self.record_path)

    def _write_record(self, record: PickRecord) -> None:
        if record != self._record():
            write_json(self.record_path, record)

    def _certain_files(self, record: PickRecord) -> list[Path]:
        files = [self.root / name for name in (LABEL_SPACE, TABLE)]
        return files + [p for s in record.picked for p in self.paths(s.sequence, s.scan)]

    def _unrecorded_frames(self, record: PickRecord) -> list[Path]:
        """Return the files of frames that an earlier version wrote."""
        sequences = {scan.sequence for scan in record.picked}
        paths = [self.root / "sequences" / name / FRAMES for name in sorted(sequences)]
        written = self.states()
        return [path for path in paths if path in written or present(path)]

    def _files(self, record: PickRecord) -> list[Path]:
        folders = sorted({self.root / "sequences" / scan.sequence for scan in record.picked})
        uncertain = [folder / name for folder in folders for name in (POSES, CALIBRATION, FRAMES)]
        tools = self.root / TOOL_FOLDER
        tool_files = [path for path in self.written() if tools in path.parents]
        return [*self._certain_files(record), *uncertain, *tool_files]

    def _require_unchanged(self, record: PickRecord) -> None:
        """Refuse to replace imported labels and files that changed since `pick` wrote them."""
        records = [self.root / name for name in IMPORTED]
        imports = [path for path in records if present(path)]
        if imports:
            problem = "records imported labels, which are not replaced"
            raise OutputError(imports[0], problem, hint="choose another folder")
        self.refuse_foreign(self._files(record))
        for scan in record.picked:
            labels = self.paths(scan.sequence, scan.scan).labels
            digest = record.pre_labels.get(scan.name)
            # Other commands write labels too.
            if digest and present(labels) and fingerprint(labels) != digest:
                raise foreign_file(labels)
