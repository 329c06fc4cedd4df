# SPDX-License-Identifier: MIT
"""A data set of synthetic streets in SemanticKITTI's layout."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from salsanext_cli.classes import LabelSpace, label_space
from salsanext_cli.errors import OutputError, UsageError
from salsanext_cli.packages import import_open3d
from salsanext_cli.parallel.run import Progress
from salsanext_cli.parallel.threads import worker_count
from salsanext_cli.storage.atomic import write_text
from salsanext_cli.storage.json_files import read_json, write_json
from salsanext_cli.storage.point_files import write_bin, write_labels
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.ids import ABSENT

MANIFEST = "synth.json"
LONGEST = 3000.0
"""Longest drive of one sequence, metres; the whole street is held in memory."""
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@dataclass(frozen=True, slots=True)
class Synthesised:
    """What was written.

    Attributes
    ----------
    folder : Path
        The data set's root.
    splits : dict of str to tuple of str
        Sequence names by split.
    scans : int
        Over all sequences.
    points : dict of int to int
        Points by raw id.
    """

    folder: Path
    splits: dict[str, tuple[str, ...]]
    scans: int
    points: dict[int, int]


@dataclass(frozen=True, slots=True)
class _Sequence:
    """One sequence to be written."""

    out: Path
    number: int
    scans: int
    seed: int
    spacing: float

    @property
    def folder(self) -> Path:
        return self.out / "sequences" / _name(self.number)


def synthesise(
    out: Path,
    *,
    train: int = 8,
    valid: int = 2,
    test: int = 0,
    scans: int = 20,
    seed: int = 0,
    spacing: float = 3.0,
    jobs: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Synthesised:
    """Write a data set of synthetic streets: scans, labels, poses, times, `labels.yaml`.

    Parameters
    ----------
    out : Path
        The data set's root; `out/sequences/00` and so on are written.
    train, valid, test : int
        Number of sequences per split, numbered in this order.
    scans : int
        Scans per sequence.
    seed : int
        The same seed gives the same bytes, whatever `jobs` is.
    spacing : float
        Metres that the vehicle drives between two scans.
    jobs : int
        Processes that work side by side, each on a sequence; -1 is one per core.
    overwrite : bool
        Whether an earlier synthetic data set in `out` may be replaced.
    progress : callable, optional
        Called with the number of scans done and the number to do.

    Raises
    ------
    UsageError
        If a number makes no sense.
    OutputError
        If the folder holds something already or cannot be written.
    MissingDependency
        If open3d cannot be loaded.
    """
    _check(train, valid, test, scans, seed, spacing, jobs)
    numbers = iter(range(train + valid + test))
    splits = {
        split: tuple(_name(next(numbers)) for _ in range(count))
        for split, count in (("train", train), ("valid", valid), ("test", test))
    }
    import_open3d()
    _claim(out, overwrite)
    settings = {"splits": splits, "scans": scans, "seed": seed, "spacing": spacing}
    write_json(out / MANIFEST, {"stage": "synth", "settings": settings})
    sequences = [_Sequence(out, n, scans, seed, spacing) for n in range(train + valid + test)]
    total = len(sequences) * scans
    points: dict[int, int] = {}
    for done, counts in enumerate(_write(sequences, jobs), start=1):
        for label, count in counts.items():
            points[label] = points.get(label, 0) + count
        if progress:
            progress(done, total)
    space = synthetic_space(splits).to_dict()
    write_text(out / "labels.yaml", yaml.safe_dump(space, sort_keys=False, allow_unicode=True))
    return Synthesised(out, splits, total, dict(sorted(points.items())))


def synthetic_space(splits: dict[str, tuple[str, ...]]) -> LabelSpace:
    """Return SemanticKITTI's label space with these splits and without what the street lacks."""
    real = label_space("semantic-kitti")
    ignored = tuple(
        flag or name in ABSENT for flag, name in zip(real.ignored, real.names, strict=True)
    )
    return LabelSpace(
        "synthetic-street",
        real.labels,
        real.learning_map,
        real.learning_map_inv,
        ignored,
        real.colours,
        splits,
    )


def _name(number: int) -> str:
    return f"{number:02d}"


def _check(
    train: int, valid: int, test: int, scans: int, seed: int, spacing: float, jobs: int
) -> None:
    for name, count, least in (
        ("--train", train, 0),
        ("--valid", valid, 0),
        ("--test", test, 0),
        ("--scans", scans, 1),
        ("--seed", seed, 0),
    ):
        if count < least:
            raise UsageError(name, str(count), f"a whole number of at least {least}")
    if train + valid + test == 0:
        raise UsageError("--train, --valid, --test", "0 sequences", "at least one")
    if not spacing > 0 or spacing * (scans - 1) > LONGEST:
        raise UsageError(
            "--spacing",
            f"{spacing} m, a drive of {spacing * (scans - 1):.0f} m",
            f"more than 0 m, and drives of up to {LONGEST:.0f} m",
            "ask for more sequences with fewer scans",
        )
    worker_count(jobs)


def _claim(out: Path, overwrite: bool) -> None:
    """Make sure that nothing but an earlier synthetic data set is replaced, and remove that."""
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    earlier = read_json(out / MANIFEST) if out.is_dir() else None
    if earlier is None:
        raise OutputError(out, "holds something else", "a new or empty folder")
    if not overwrite:
        raise OutputError(
            out, "holds a synthetic data set", "a new or empty folder", "--overwrite replaces it"
        )
    # Not what the manifest names: it could name folders elsewhere.
    for sequence in (out / "sequences").glob("[0-9]*"):
        for folder, suffix in (("velodyne", "bin"), ("labels", "label")):
            for path in (sequence / folder).glob(f"[0-9]*.{suffix}"):
                path.unlink()


def _write(sequences: list[_Sequence], jobs: int) -> Iterator[dict[int, int]]:
    """Write the sequences and yield, scan by scan, how many points each raw id has."""
    workers = min(len(sequences), worker_count(jobs))
    if workers == 1:
        for sequence in sequences:
            yield from _write_sequence(sequence)
        return
    import joblib

    parallel = joblib.Parallel(n_jobs=workers, backend="loky", return_as="generator_unordered")
    for counts in parallel(joblib.delayed(_whole)(sequence) for sequence in sequences):
        yield from counts


def _whole(sequence: _Sequence) -> list[dict[int, int]]:
    return list(_write_sequence(sequence))


def _write_sequence(sequence: _Sequence) -> Iterator[dict[int, int]]:
    """Write one sequence; poses are relative to the first scan, so that the first is identity."""
    poses, times = [], []
    first = np.eye(4)
    frames = record(sequence.seed, sequence.number, sequence.scans, sequence.spacing)
    for index, frame in enumerate(frames):
        write_bin(sequence.folder / "velodyne" / f"{index:06d}.bin", frame.scan)
        write_labels(sequence.folder / "labels" / f"{index:06d}.label", frame.labels)
        first = frame.pose if index == 0 else first
        relative = np.linalg.inv(first) @ frame.pose
        poses.append(" ".join(f"{value:.9e}" for value in relative[:3].ravel()))
        times.append(f"{frame.time:.6e}")
        raw, counts = np.unique(frame.labels, return_counts=True)
        yield dict(zip(raw.tolist(), counts.tolist(), strict=True))
    write_text(sequence.folder / "poses.txt", "\n".join(poses) + "\n")
    write_text(sequence.folder / "times.txt", "\n".join(times) + "\n")
    calibration = [f"{key}: {IDENTITY}" for key in ("P0", "P1", "P2", "P3", "Tr")]
    write_text(sequence.folder / "calib.txt", "\n".join(calibration) + "\n")
