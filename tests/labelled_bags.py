# SPDX-License-Identifier: MIT
"""Bags with predictions of their clouds, and their content as rosbags reads it."""

from pathlib import Path

import numpy as np
from bags import START, STEP, TOPIC, cloud, structured, text, write_bag
from scans import write_array

from salsanext_cli import write_labels
from salsanext_cli.runs.results.paths import output_path

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


def messages_of(path: Path) -> list:
    """Return topic, time and message of a bag, as rosbags reads it, and its raw content."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return [
            (c.topic, time, reader.deserialize(raw, c.msgtype), bytes(raw))
            for c, time, raw in reader.messages()
        ]
