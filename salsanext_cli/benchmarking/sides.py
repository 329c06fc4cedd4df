# SPDX-License-Identifier: MIT
"""What each side of a benchmark does, part by part: the baseline and the product."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import salsanext_cli
from salsanext_cli.errors import SalsanextError
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.network.weights import default_weights, read_card
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.predict import most_probable, predict
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.uncertainty.settings import Estimator

Parts = dict[str, tuple[Callable[[], object], float]]
"""By name what does a part of the method, and how often that is needed."""
SAMPLES = 30
"""Monte-Carlo passes of a scan."""


@dataclass(frozen=True, slots=True)
class Task:
    """What both sides are to do.

    Attributes
    ----------
    network : NetworkChoice
        Weights, device and sensor, all of them named.
    scans, out : Path
        A folder of `.bin` files, and one for results.
    passes : int
        How many of the baseline's Monte-Carlo passes, which are alike, are timed.
    """

    network: NetworkSettings
    scans: Path
    out: Path
    passes: int

    @property
    def weights(self) -> Path:
        """The weights file."""
        return self.network.weights or default_weights()

    @property
    def sensor(self) -> Sensor:
        """What the scans come from."""
        return self.network.sensor or read_card(self.weights).sensor


def baseline_path() -> Path:
    """Return the file of the baseline: in an installed package, or beside one in a checkout.

    Raises
    ------
    SalsanextError
        If it is in neither place.
    """
    package = Path(salsanext_cli.__file__).parent
    places = [folder / "benchmarks" / "baseline.py" for folder in (package, package.parent)]
    for place in places:
        if place.is_file():
            return place
    raise SalsanextError(
        places[-1], "no such file", "the baseline", "install the package, or use a whole checkout"
    )


class Product:
    """The toolkit itself, by its public functions."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.network = task.network.load()
        self.estimator = Estimator(samples=SAMPLES)
        self.place = str(self.network.device)
        self.precision = self.network.precision

    def parts(self, file: ScanFile) -> Parts:
        """Return what does each part for a scan."""
        network, place = self.network, self.place
        count, sensor = network.card.space.class_count, network.sensor
        scan = read_scan(file.path)
        image = project(scan, sensor, place)
        pixel_labels = most_probable(network.probabilities(image))
        labels = knn_refine(image, pixel_labels, count, device=place)
        seen = np.where(image.pixel_of_point < 0, 0, pixel_labels.ravel()[image.pixel_of_point])
        return {
            "projection": (lambda: project(scan, sensor, place), 1),
            "network": (lambda: network.probabilities(image), 1),
            "knn": (lambda: knn_refine(image, pixel_labels, count, device=place), 1),
            "uncertainty": (lambda: self.estimator.estimate(network, image, file), 1),
            "confusion": (lambda: Confusion(count).update(labels, seen), 1),
        }

    def predict(self) -> float:
        """Label all scans, file to file, a second time; return the seconds of each."""
        options, out = RunOptions(overwrite=True), self.task.out / "product"
        for _ in range(2):
            start = time.perf_counter()
            outcome = predict(self.task.scans, out, network=self.task.network, options=options)
            seconds = time.perf_counter() - start
            if outcome.failures:
                raise SalsanextError(outcome.failures[0].reason)
        return seconds / outcome.done


class Baseline:
    """The method written plainly, by the functions of its file."""

    def __init__(self, task: Task) -> None:
        self.task = task
        sys.path.insert(0, str(baseline_path().parent))
        self.plain: Any = importlib.import_module("baseline")
        sensor = task.sensor.to_dict()
        self.method = self.plain.Baseline(task.weights, task.network.device, sensor)
        self.precision = "float32"

    def parts(self, file: ScanFile) -> Parts:
        """Return what does each part for a scan."""
        plain, method, passes = self.plain, self.method, self.task.passes
        points = plain.read_points(file.path)
        points = points[plain.seen(points, method.sensor)]
        image, pixel, depth = plain.project(points, method.sensor)
        pixel_labels = method.probabilities(image).argmax(0).astype(np.uint8)
        labels = method.refine(image, pixel_labels, pixel, depth)
        seen = pixel_labels.ravel()[pixel]
        return {
            "projection": (lambda: plain.project(points, method.sensor), 1),
            "network": (lambda: method.probabilities(image), 1),
            "knn": (lambda: method.refine(image, pixel_labels, pixel, depth), 1),
            "uncertainty": (lambda: method.uncertainty(image, passes), SAMPLES / passes),
            "confusion": (lambda: plain.confusion(labels, seen, method.classes), 1),
        }

    def predict(self) -> float:
        """Label all scans, file to file, after one that does not count; return seconds of each."""
        out = self.task.out / "baseline.label"
        files = find_scans(self.task.scans)
        self.method.label(files[0].path, out)
        start = time.perf_counter()
        for file in files:
            self.method.label(file.path, out)
        return (time.perf_counter() - start) / len(files)
