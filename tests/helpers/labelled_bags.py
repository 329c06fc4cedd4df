# SPDX-License-Identifier: MIT
"""Bags with predictions of their clouds, and their content as rosbags reads it."""

from pathlib import Path

import numpy as np
from bags import START, STEP, TOPIC, cloud, structured, text, write_bag
from scans import make_scan, write_array, write_bin

from salsanext_cli import label_space, sensor, write_labels
from salsanext_cli.runs.results.manifest import Manifest, ScanSource, StageRecord
from salsanext_cli.runs.results.output_paths import output_path

NAMES = (f"{START}", f"{START + STEP}", f"{START + STEP}_1")
"""Names of the scans; the last two clouds have one time."""
POINTS = [structured(6, seed) for seed in range(3)]
CAR, PERSON, ROAD = 10, 30, 40
LABELS = ([CAR, ROAD, CAR, 0, ROAD, PERSON], [CAR] * 6, [ROAD] * 5 + [CAR])


class LabelledBag:
    """A bag of three clouds, a cloud of another topic and a text, and a folder of predictions."""

    def __init__(self, folder: Path, kind: str, *, name: str = "", further: tuple = ()) -> None:
        self.out = folder / "out"
        clouds = [cloud(POINTS[0]), cloud(POINTS[1], height=2, row_padding=5), cloud(POINTS[2])]
        times = (START, START + STEP, START + STEP)
        written = [(TOPIC, time, make) for time, make in zip(times, clouds, strict=True)]
        others = [("/rear", START + 1, cloud(POINTS[0])), ("/name", START + 2, text)]
        others += [("/empty", START + 3, cloud(structured(0)))]
        path = write_bag(folder / name, kind, [*written, *others, *further])
        self.path = path if kind == ".bag" else path.parent
        self.topic = self.path / TOPIC.strip("/")
        for stem, labels in zip(NAMES, LABELS, strict=True):
            self.label(stem, labels)

    def label(self, stem, labels, sequence="drive"):
        """Write the predictions of a cloud."""
        path = output_path(self.out, sequence, "predictions", stem)
        write_labels(path, np.array(labels, np.uint32))

    def put(self, stem, error, sequence="drive"):
        """Write the probabilities of error of a cloud."""
        path = output_path(self.out, sequence, "uncertainty/error", stem)
        write_array(path, np.array(error, np.float32))


def record_sources(out: Path, sources: dict[str, ScanSource]) -> None:
    """Record where `predict` found the scans of each sequence."""
    settings = {"label_space": label_space().to_dict(), "sensor": sensor("hdl64").to_dict()}
    record = StageRecord(stage="predict", settings=settings, writes=("predictions",), scans=sources)
    Manifest(out).write(record)


def label_a_file_too(bag: LabelledBag, folder: Path) -> Path:
    """Label a scan in a file of a folder beside the clouds of a bag; return its path."""
    path = folder / "000000.bin"
    write_bin(path, make_scan(6))
    bag.label(path.stem, [ROAD] * 6, folder.name)
    clouds = ScanSource(str(bag.topic), dict.fromkeys(NAMES, ""))
    files = ScanSource(str(folder), {path.stem: path.suffix})
    record_sources(bag.out, {"drive": clouds, folder.name: files})
    return path


def messages_of(path: Path) -> list:
    """Return topic, time and message of a bag, as rosbags reads it, and its raw content."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return [
            (c.topic, time, reader.deserialize(raw, c.msgtype), bytes(raw))
            for c, time, raw in reader.messages()
        ]
