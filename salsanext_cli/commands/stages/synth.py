# SPDX-License-Identifier: MIT
"""Stage `synth`: a data set of simulated scenes in SemanticKITTI's layout."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import yaml

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.optional_packages import import_open3d
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import filled
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.kitti_labels import encode_labels, read_labels
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.loop.run import Progress, RunOptions, run_over_scans
from salsanext_cli.runs.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.lidar import RIGS

STAGE = "synth"
LABEL_SPACE = "labels.yaml"
MAX_DRIVE_M = 3000.0  # Longest drive of a sequence, whose scene is in memory
SEQUENCE_FILES = ("poses.txt", "times.txt", "calib.txt")
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthSettings:
    """Settings that determine a data set of simulated scenes."""

    splits: dict[str, tuple[str, ...]]  # Names of the sequences by split
    scans: int  # Number of scans of a sequence
    seed: int
    spacing: float  # Distance between scans in metres
    sensor: str  # Name of one of `RIGS`

    @classmethod
    def from_counts(
        cls, counts: Mapping[str, int], scans: int, seed: int, spacing: float, sensor: str
    ) -> "SynthSettings":
        """Name the sequences by their number in each split."""
        names = map("{:02d}".format, range(sum(counts.values())))
        splits = {split: tuple(islice(names, count)) for split, count in counts.items()}
        return cls(splits=splits, scans=scans, seed=seed, spacing=spacing, sensor=sensor)

    @property
    def record(self) -> StageRecord:
        """Record of the stage."""
        return StageRecord(stage=STAGE, settings=settings_json(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class SynthReport:
    """Data set of simulated scenes that was written."""

    scans: int  # Of all sequences
    splits: Mapping[str, Sequence[str]]  # Names of the sequences by split
    points: Mapping[int, int]  # Number of points by raw id

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {"stage": STAGE, "scans": self.scans, "splits": self.splits, "points": self.points}


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
    cluster: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SynthReport:
    """Write a data set of simulated scenes, or what is missing of it.

    Parameters
    ----------
    out : Path
        Folder of the data set.
    train : int
        Number of sequences of the split ``train``.
    valid : int
        Number of sequences of the split ``valid``.
    test : int
        Number of sequences of the split ``test``.
    scans : int
        Number of scans of a sequence.
    seed : int
        Seed; the same seed gives the same bytes.
    spacing : float
        Distance between scans in metres.
    sensor : str
        Name of one of `RIGS`.
    jobs : int
        Number of worker processes.
    cluster : str, optional
        Address of a Ray cluster that simulates instead.
    overwrite : bool
        Whether to replace an earlier simulated data set.
    progress : callable, optional
        Called with the numbers of finished and of all sequences.

    Returns
    -------
    SynthReport
    """
    counts = {"train": train, "valid": valid, "test": test}
    options = RunOptions(jobs=jobs, cluster=cluster, on_error="stop", progress=progress)
    _check(counts, scans, seed, spacing, sensor)
    settings = SynthSettings.from_counts(counts, scans, seed, spacing, sensor)
    names = [name for members in settings.splits.values() for name in members]
    files = [path for name in names for path in _files(out / "sequences" / name, scans)]
    files.append(out / LABEL_SPACE)
    owned = OwnedFolder(out, STAGE)
    owned.require_new()
    if overwrite or not all(map(filled, files)):
        import_open3d()
    points: Counter[int] = Counter()
    write = partial(_write_sequence, owned=owned, settings=settings)
    sequences = [
        ScanFile(sequence=name, stem=name, path=out / "sequences" / name) for name in names
    ]
    with owned.open():
        _begin(owned, settings.record, files, overwrite)
        run_over_scans(write, sequences, options, on_result=points.update, writes=[out])
        space = replace(label_space("semantic-kitti"), splits=settings.splits)
        text = yaml.safe_dump(space.to_dict(), sort_keys=False, allow_unicode=True)
        owned.write_missing(out / LABEL_SPACE, text.encode())
    return SynthReport(
        scans=len(names) * scans, splits=settings.splits, points=dict(sorted(points.items()))
    )


def _check(sequences: dict[str, int], scans: int, seed: int, spacing: float, sensor: str) -> None:
    for split, count in sequences.items():
        _require_at_least(split, count, 0)
    _require_at_least("scans", scans, 1)
    _require_at_least("seed", seed, 0)
    if sum(sequences.values()) == 0:
        raise UsageError(", ".join(map(argument, sequences)), "no sequences", "at least one")
    if not 0 < spacing < math.inf or spacing * (scans - 1) > MAX_DRIVE_M:
        problem = f"{spacing} m between {counted(scans, 'scan')}"
        expected = f"more than 0 m, and drives of up to {MAX_DRIVE_M:.0f} m"
        hint = "use more sequences with fewer scans"
        raise UsageError(argument("spacing"), problem, expected, hint)
    if sensor not in RIGS:
        raise UsageError(argument("sensor"), sensor, f"one of {', '.join(RIGS)}")


def _require_at_least(name: str, count: int, least: int) -> None:
    if count < least:
        raise UsageError(argument(name), str(count), f"a whole number of at least {least}")


def _begin(owned: OwnedFolder, new: StageRecord, files: list[Path], overwrite: bool) -> None:
    """Write the record, after removing an earlier data set that is to be replaced."""
    out = owned.root
    earlier = owned.manifest.record(STAGE)
    if earlier is not None and not overwrite:
        is_complete = all(map(filled, files))
        _require_same(owned, earlier, new, is_complete=is_complete)
        if is_complete:
            return
    folders = {folder for path in files for folder in path.parents if out in folder.parents}
    links = sorted(folder for folder in folders if folder.is_symlink())
    owned.refuse_foreign([*links, *files])
    # The record stays until it is replaced, so that a killed run can continue.
    if overwrite:
        owned.remove_written([path for path in owned.written() if _is_generated(path, out)])
    owned.manifest.write(new)


def _require_same(
    owned: OwnedFolder, earlier: StageRecord, new: StageRecord, *, is_complete: bool
) -> None:
    """Refuse to continue a data set of other settings, or an incomplete one of another version."""
    before = dict(earlier.settings)
    now = dict(new.settings)
    if not is_complete:
        # Versions may write other bytes.
        before["version"] = earlier.version
        now["version"] = new.version
    require_same_settings(owned.record_path, before, now)


def _is_generated(path: Path, out: Path) -> bool:
    """Return whether `synth` writes files at this path, unlike other stages."""
    match path.relative_to(out).parts:
        case (name,):
            return name == LABEL_SPACE
        case ("sequences", _, name):
            return name in SEQUENCE_FILES
        case ("sequences", _, folder, _):
            return folder in ("velodyne", "labels")
    return False


def _files(sequence: Path, scans: int) -> list[Path]:
    pairs = [path for index in range(scans) for path in _scan_files(sequence, index)]
    return [*pairs, *(sequence / name for name in SEQUENCE_FILES)]


def _scan_files(sequence: Path, index: int) -> tuple[Path, Path]:
    stem = f"{index:06d}"
    return sequence / "velodyne" / f"{stem}.bin", sequence / "labels" / f"{stem}.label"


def _write_sequence(file: ScanFile, owned: OwnedFolder, settings: SynthSettings) -> Counter[int]:
    """Write the missing files of a sequence; return the number of points by raw id."""
    folder = file.path
    if all(map(filled, _files(folder, settings.scans))):
        return _counted_points(folder, settings.scans)
    points: Counter[int] = Counter()
    poses: list[str] = []
    times: list[str] = []
    first_pose = np.eye(4)
    rig = RIGS[settings.sensor]
    frames = record(settings.seed, int(file.sequence), settings.scans, settings.spacing, rig)
    for index, frame in enumerate(frames):
        scan, labels = _scan_files(folder, index)
        owned.write_missing(scan, encode_bin(frame.scan))
        owned.write_missing(labels, encode_labels(frame.labels))
        if index == 0:
            first_pose = frame.pose
        relative = np.linalg.inv(first_pose) @ frame.pose
        poses.append(" ".join(f"{value:.9e}" for value in relative[:3].ravel()))
        times.append(f"{frame.time:.6e}")
        points += _points_of(frame.labels)
    calibration = [f"{key}: {IDENTITY}" for key in ("P0", "P1", "P2", "P3", "Tr")]
    for name, lines in zip(SEQUENCE_FILES, (poses, times, calibration), strict=True):
        owned.write_missing(folder / name, ("\n".join(lines) + "\n").encode())
    return points


def _counted_points(folder: Path, scans: int) -> Counter[int]:
    """Return the number of points of a written sequence by raw id."""
    points: Counter[int] = Counter()
    for index in range(scans):
        _, labels = _scan_files(folder, index)
        points += _points_of(read_labels(labels))
    return points


def _points_of(labels: RawIds) -> Counter[int]:
    raw, counts = np.unique(labels, return_counts=True)
    return Counter(dict(zip(raw.tolist(), counts.tolist(), strict=True)))
