# SPDX-License-Identifier: MIT
"""Data set of synthetic streets, in SemanticKITTI's layout."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from salsanext_cli.classes.label_space import RawIds, label_space
from salsanext_cli.errors import UsageError, counted
from salsanext_cli.files.optional_packages import import_open3d
from salsanext_cli.files.reading import filled
from salsanext_cli.formats.kitti import encode_bin, encode_labels, read_labels
from salsanext_cli.parallel.run import Progress, RunOptions, run_over_scans
from salsanext_cli.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.rig import RIGS

STAGE = "synth"
LABEL_SPACE = "labels.yaml"
MAX_DRIVE_M = 3000.0  # Longest drive of a sequence, whose street is held in memory
SEQUENCE_FILES = ("poses.txt", "times.txt", "calib.txt")
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@dataclass(frozen=True, slots=True)
class SynthSettings:
    """Settings that decide what a data set of synthetic streets is."""

    splits: dict[str, tuple[str, ...]]  # Names of the sequences by split
    scans: int  # Number of scans of a sequence
    seed: int
    spacing: float  # Distance between scans in metres
    sensor: str  # Name of one of `RIGS`

    @classmethod
    def of(
        cls, counts: Mapping[str, int], scans: int, seed: int, spacing: float, sensor: str
    ) -> "SynthSettings":
        """Name the sequences by their number in each split."""
        names = map("{:02d}".format, range(sum(counts.values())))
        splits = {split: tuple(islice(names, count)) for split, count in counts.items()}
        return cls(splits, scans, seed, spacing, sensor)

    @property
    def record(self) -> StageRecord:
        """Record of the stage with these settings."""
        return StageRecord(STAGE, settings_json(self))


def synthesise(
    out: Path,
    *,
    train: int = 8,
    valid: int = 2,
    test: int = 0,
    scans: int = 20,
    seed: int = 0,
    spacing: float = 3.0,
    sensor: str = "hdl64",
    jobs: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write what is missing of a data set of synthetic streets, the same bytes for a `seed`.

    Returns the number of all `scans`, names of sequences by split, and `points` by raw id.
    """
    counts = {"train": train, "valid": valid, "test": test}
    options = RunOptions(jobs=jobs, on_error="stop", progress=progress)
    _check({f"--{split}": count for split, count in counts.items()}, scans, seed, spacing)
    if sensor not in RIGS:
        raise UsageError("--sensor", sensor, f"one of {', '.join(RIGS)}")
    made_with = SynthSettings.of(counts, scans, seed, spacing, sensor)
    splits = made_with.splits
    names = [name for members in splits.values() for name in members]
    files = [path for name in names for path in _files(out / "sequences" / name, scans)]
    files.append(out / LABEL_SPACE)
    owned = OwnedFolder(out, STAGE)
    owned.require_new()
    if overwrite or not all(map(filled, files)):
        import_open3d()
    points: Counter[int] = Counter()
    write = partial(_write_sequence, owned=owned, scans=scans, seed=seed, spacing=spacing)
    write = partial(write, sensor=sensor)
    # Sequences are the units of the run.
    units = [ScanFile(name, name, out / "sequences" / name) for name in names]
    with owned.open():
        _begin(owned, made_with, files, overwrite)
        run_over_scans(write, units, options, on_result=points.update)
        space = replace(label_space("semantic-kitti"), splits=splits)
        text = yaml.safe_dump(space.to_dict(), sort_keys=False, allow_unicode=True)
        owned.write_missing(out / LABEL_SPACE, text.encode())
    made = {"scans": len(names) * scans, "splits": splits, "points": dict(sorted(points.items()))}
    return {"stage": STAGE, **made}


def _check(sequences: dict[str, int], scans: int, seed: int, spacing: float) -> None:
    least = {**dict.fromkeys(sequences, 0), "--scans": 1, "--seed": 0}
    for name, count in {**sequences, "--scans": scans, "--seed": seed}.items():
        if count < least[name]:
            raise UsageError(name, str(count), f"a whole number of at least {least[name]}")
    if sum(sequences.values()) == 0:
        raise UsageError(", ".join(sequences), "0 sequences", "at least one")
    if not 0 < spacing < math.inf or spacing * (scans - 1) > MAX_DRIVE_M:
        found = f"{spacing} m between {counted(scans, 'scan')}"
        expected = f"more than 0 m, and drives of up to {MAX_DRIVE_M:.0f} m"
        raise UsageError("--spacing", found, expected, "ask for more sequences with fewer scans")


def _begin(
    owned: OwnedFolder, made_with: SynthSettings, files: list[Path], overwrite: bool
) -> None:
    """Record what is made, after removing an earlier data set if that is to be replaced."""
    out, wanted = owned.root, made_with.record
    if (earlier := owned.manifest.record(STAGE)) and not overwrite:
        # A data set that is whole may be of another version.
        whole = all(map(filled, files))
        before, now = (
            {**each.settings, **({} if whole else {"version": each.version})}
            for each in (earlier, wanted)
        )
        require_same_settings(owned.record_path, before, now)
        if whole:
            return
    folders = {folder for path in files for folder in path.parents if out in folder.parents}
    links = sorted(folder for folder in folders if folder.is_symlink())
    owned.refuse_foreign([*links, *files])
    # The record stays until it is replaced, so that a run that is killed before may go on.
    if overwrite:
        owned.remove_written([path for path in owned.written() if _is_generated(path, out)])
    owned.manifest.write(wanted)


def _is_generated(path: Path, out: Path) -> bool:
    """Say whether a file has a place that `synth` fills; other stages may have results beside."""
    match path.relative_to(out).parts:
        case (name,):
            return name == LABEL_SPACE
        case ("sequences", _, name):
            return name in SEQUENCE_FILES
        case ("sequences", _, folder, _):
            return folder in ("velodyne", "labels")
    return False


def _files(sequence: Path, scans: int) -> list[Path]:
    of_scans = [path for index in range(scans) for path in _scan_files(sequence, index)]
    return [*of_scans, *(sequence / name for name in SEQUENCE_FILES)]


def _scan_files(sequence: Path, index: int) -> tuple[Path, Path]:
    stem = f"{index:06d}"
    return sequence / "velodyne" / f"{stem}.bin", sequence / "labels" / f"{stem}.label"


def _write_sequence(
    file: ScanFile, owned: OwnedFolder, scans: int, seed: int, spacing: float, sensor: str
) -> Counter[int]:
    """Write what is missing of a sequence; return how many points each raw id has."""
    folder, points = file.path, Counter[int]()
    if all(map(filled, _files(folder, scans))):
        for index in range(scans):
            points += _points_of(read_labels(_scan_files(folder, index)[1]))
        return points
    poses, times, first = [], [], np.eye(4)
    frames = record(seed, int(file.sequence), scans, spacing, RIGS[sensor])
    for index, frame in enumerate(frames):
        scan, labels = _scan_files(folder, index)
        owned.write_missing(scan, encode_bin(frame.scan))
        owned.write_missing(labels, encode_labels(frame.labels))
        first = frame.pose if index == 0 else first
        relative = np.linalg.inv(first) @ frame.pose
        poses.append(" ".join(f"{value:.9e}" for value in relative[:3].ravel()))
        times.append(f"{frame.time:.6e}")
        points += _points_of(frame.labels)
    calibration = [f"{key}: {IDENTITY}" for key in ("P0", "P1", "P2", "P3", "Tr")]
    for name, lines in zip(SEQUENCE_FILES, (poses, times, calibration), strict=True):
        owned.write_missing(folder / name, ("\n".join(lines) + "\n").encode())
    return points


def _points_of(labels: RawIds) -> Counter[int]:
    raw, counts = np.unique(labels, return_counts=True)
    return Counter(dict(zip(raw.tolist(), counts.tolist(), strict=True)))
