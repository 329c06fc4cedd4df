# SPDX-License-Identifier: MIT
"""The toolkit's side of a benchmark: each part by public functions of the package."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import salsanext_cli as sn
from benchmarks.speed.speed_hardware import describe
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.measures.scores import confusion_matrix
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.runs.scans.scan_file import ScanFile


def predict(path: Path, out: Path, network: sn.Network) -> None:
    """Label the points of one scan, file to file, by the steps of `salsanext predict`."""
    space = network.space
    image = sn.project(sn.read_scan(path), network.sensor)
    pixel_labels = network.probabilities(image).argmax(axis=0).astype(np.uint8)
    labels = sn.knn_refine(image, pixel_labels, space.class_count)
    sn.write_labels(out, space.to_raw(labels))


def prepare(part: str, path: Path, task: Mapping[str, Any]) -> Callable[[], Any]:
    """Compute the input of a part for one scan, and return the function that is timed."""
    sensor = sn.Sensor.from_dict(task["sensor"])
    settings = (task["weights"], task["device"], sensor, task["precision"], task["engine"])
    network = sn.load_network(*settings)
    scan, count = sn.read_scan(path), network.space.class_count
    image, file = sn.project(scan, sensor), ScanFile(sequence="", stem=path.stem, path=path)
    work: dict[str, Callable[[], Any]] = {
        "hardware": lambda: describe(network.device, network.backend.precision),
        "projection": lambda: sn.project(scan, sensor),
        "network": lambda: network.probabilities(image),
        "predict": lambda: predict(path, path.with_suffix(".label"), network),
        # With the paper's aleatoric uncertainty, as the baseline.
        "uncertainty": lambda: UncertaintyMethod(
            samples=task["samples"], aleatoric="paper"
        ).estimate(network, image, scan_seed(0, file.sequence, file.stem)),
    }
    if part in work:
        return work[part]
    pixel_labels = network.probabilities(image).argmax(axis=0).astype(np.uint8)
    if part == "knn":
        return lambda: sn.knn_refine(image, pixel_labels, count)
    labels = sn.knn_refine(image, pixel_labels, count)
    before = points_from_pixels(pixel_labels, image.pixel_of_point, 0)
    return lambda: confusion_matrix(labels, before, count)
