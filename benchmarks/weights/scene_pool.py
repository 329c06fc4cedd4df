# SPDX-License-Identifier: MIT
"""Simulated scenes that processes make while a training reads them.

A scene is a short drive, `SCANS` scans of one sensor. It becomes visible when it is complete, with
the sensor that `predict` would fit to it beside its scans.

As a command, it adds scenes to a pool while a training reads it; complete ones stay.

Run: python -m benchmarks.weights.scene_pool SCENES [--seed 10] [--first 0] [--scenes 100]
     [--scans 8] [--weights default]
"""

import argparse
import json
import multiprocessing
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

from filelock import FileLock, Timeout

from benchmarks.weights.ray_casting import RayScene
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.loop.pool import end_with_parent
from salsanext_cli.runs.network_settings import weights_file
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.lidar import RIGS
from salsanext_cli.training.data.sources import Source, fitted_source

KINDS = tuple(RIGS)
VALIDATION = "validation"
SCANS, SPACING_M = 8, 10.0
VALIDATION_SCANS, VALIDATION_SPACING_M = 2, 40.0
NICENESS = 5  # Training and its loaders go before
REFRESH_S = 5.0  # Seconds after which new scenes are looked for
SENSOR = "sensor.json"


@dataclass(frozen=True)
class ScenePool:
    """A folder of scenes of each kind of sensor, and of scenes to validate on."""

    root: Path
    sensor: Sensor  # That the network is trained for
    seed: int = 0
    scans: int = SCANS
    validation: int = 5  # Number of scenes to validate on, which are made first

    def make(self, number: int) -> None:
        """Make a scene; its number decides the street, the sensor and the noise."""
        if number < self.validation:
            name, kind, seed = VALIDATION, KINDS[0], self.seed
            scans, spacing = VALIDATION_SCANS, VALIDATION_SPACING_M
        else:
            number, index = divmod(number - self.validation, len(KINDS))
            name = kind = KINDS[index]
            seed, scans, spacing = self.seed + 1 + index, self.scans, SPACING_M
        write_scene(self.root / name, number, kind, seed, scans, spacing, self.sensor)

    def source(self, name: str, planned: int = 0) -> Source:
        """Return the scenes of a folder: those of now or, if some are planned, as they come."""
        folder = self.root / name / "sequences"
        fitted: Mapping[str, Sensor] = FittedSensors(folder, self.sensor.width)
        if planned:
            return Source(
                files=Scenes(folder, planned),
                space=label_space(),
                sensor=self.sensor,
                fitted=fitted,
                simulated=True,
            )
        files = find_scans(folder.parent)
        fitted = {file.sequence: fitted[file.sequence] for file in files}
        return Source(
            files=files, space=label_space(), sensor=self.sensor, fitted=fitted, simulated=True
        )

    def count(self, name: str) -> int:
        """Return the number of scenes that are complete."""
        folder = self.root / name / "sequences"
        return len([*folder.iterdir()]) if folder.is_dir() else 0

    def complete(self, number: int) -> None:
        """Make a scene to train on by its number, unless it is complete or in the making.

        The draft of a process that was killed is replaced.
        """
        scene, index = divmod(number, len(KINDS))
        root = self.root / KINDS[index]
        complete = root / "sequences" / f"{scene:06}"
        if complete.exists():
            return
        (root / "drafts").mkdir(parents=True, exist_ok=True)
        # The lock of a process ends with it, unlike a folder that it made.
        claim = FileLock(root / "drafts" / f"{scene:06}.lock", timeout=0)
        with suppress(Timeout), claim:
            if complete.exists():
                return
            shutil.rmtree(root / "drafts" / "sequences" / f"{scene:06}", ignore_errors=True)
            self.make(number + self.validation)

    @contextmanager
    def working(self, processes: int) -> Iterator[list[BaseProcess]]:
        """Make scenes in so many processes for the duration of the context."""
        context = multiprocessing.get_context("spawn")
        counter = context.Value("q", 0)
        workers: list[BaseProcess] = [
            context.Process(target=work, args=(self, counter, os.getpid()), daemon=True)
            for _ in range(processes)
        ]
        for worker in workers:
            worker.start()
        try:
            yield workers
        finally:
            for worker in workers:
                worker.kill()
            for worker in workers:
                worker.join()


def work(pool: ScenePool, counter: object, parent: int) -> None:
    """Make one scene after the other until the process is ended."""
    end_with_parent(parent)
    os.nice(NICENESS)
    while True:
        with counter.get_lock():  # type: ignore[attr-defined]
            number = counter.value  # type: ignore[attr-defined]
            counter.value += 1  # type: ignore[attr-defined]
        pool.make(number)


def write_scene(
    root: Path, number: int, kind: str, seed: int, scans: int, spacing: float, sensor: Sensor
) -> None:
    """Simulate a drive, fit the sensor to it, and move it to its place when it is complete."""
    name = f"{number:06}"
    draft, place = root / "drafts" / "sequences" / name, root / "sequences" / name
    frames = record(seed, number, scans, spacing, RIGS[kind], RayScene)
    for index, frame in enumerate(frames):
        stem = f"{index:06}"
        write_bytes(draft / "velodyne" / f"{stem}.bin", encode_bin(frame.scan))
        write_bytes(draft / "labels" / f"{stem}.label", encode_labels(frame.labels))
    fitted = fitted_source(
        Source(files=find_scans(draft), space=label_space(), sensor=sensor)
    ).fitted[name]
    (draft / SENSOR).write_text(json.dumps(fitted.to_dict()))
    place.parent.mkdir(parents=True, exist_ok=True)
    draft.rename(place)


class Scenes(Sequence[ScanFile]):
    """Scans of a planned number of which those of complete scenes stand for all others."""

    def __init__(self, folder: Path, planned: int) -> None:
        self.folder, self.planned = folder, planned
        self._files: list[ScanFile] = []
        self._looked = -REFRESH_S

    def __len__(self) -> int:
        return self.planned

    def __getitem__(self, index: int) -> ScanFile:  # type: ignore[override]
        if not 0 <= index < self.planned:
            raise IndexError(index)
        if time.monotonic() - self._looked > REFRESH_S:
            self._files, self._looked = find_scans(self.folder.parent), time.monotonic()
        return self._files[index % len(self._files)]


class FittedSensors(Mapping[str, Sensor]):
    """The sensor of each scene for images of a width, read when it is first asked for."""

    def __init__(self, folder: Path, width: int) -> None:
        self.folder, self.width = folder, width
        self._known: dict[str, Sensor] = {}

    def __getitem__(self, scene: str) -> Sensor:
        if scene not in self._known:
            record = json.loads((self.folder / scene / SENSOR).read_text())
            self._known[scene] = Sensor.from_dict(record).resized(width=self.width)
        return self._known[scene]

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(path.name for path in self.folder.iterdir()))

    def __len__(self) -> int:
        return len([*self])


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes_folder", type=Path, metavar="SCENES")
    numbers = {"--seed": 10, "--first": 0, "--scenes": 100, "--scans": SCANS}
    for name, default in numbers.items():
        parser.add_argument(name, type=int, default=default)
    parser.add_argument("--weights", type=Path, default=Path("default"))
    given = parser.parse_args(words or None)
    sensor = read_card(weights_file(given.weights)).sensor
    pool = ScenePool(given.scenes_folder, sensor, given.seed, given.scans, validation=0)
    for scene in range(given.first, given.first + given.scenes):
        for index, kind in enumerate(KINDS):
            pool.complete(scene * len(KINDS) + index)
            print(time.ctime(), kind, scene, flush=True)


if __name__ == "__main__":
    main()
