# SPDX-License-Identifier: MIT
"""Scores of weights on labelled drives at several widths, to report and never to choose by.

For each width a table has accuracy and mean IoU of the classes present in %, of each drive and of
all, and the IoU of some classes. Points are labelled as `predict` labels them, with the sensor
fitted to each drive.

Run: python -m benchmarks.weights.drive_scores WEIGHTS DATASET... [--widths 512,1024,2048]
     [--classes person,bicyclist,truck] [--precision float32] [--json FILE]
"""

import argparse
import json
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.labellers import label_scan
from salsanext_cli.core.measures.scores import Counts, confusion_matrix, scores
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.fit.scan_reading import read_measured
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans
from salsanext_cli.runs.network_settings import NetworkSettings, weights_file
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_label_space

CLASSES = "person,bicyclist,truck"


def confusion_of_drive(
    settings: NetworkSettings, network: Network, files: Sequence[ScanFile]
) -> Counts:
    """Return the confusion (C, C) of the scans of a drive, whose sensor is fitted to them."""
    fitted = fit_scans(settings, network, sample_of_files(files, network.sensor))
    total = np.zeros((network.space.class_count, network.space.class_count), np.int64)
    for file in files:
        scan = label_scan(read_measured(file.path, fitted.sensor), fitted, source=file.path)
        space = data_set_label_space(file.path.parents[3]) or network.space
        truth = space.to_train(read_labels(file.label_path, len(scan.labels)))
        total += confusion_matrix(truth, scan.labels, network.space.class_count)
    return total


def drive_scores(settings: NetworkSettings, files: Sequence[ScanFile]) -> dict[str, Counts]:
    """Return the confusion of each drive, by its name."""
    network = settings.load()
    return {
        name: confusion_of_drive(settings, network, list(members))
        for name, members in groupby(files, lambda file: file.sequence)
    }


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("weights", type=Path)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--widths", default="512,1024,2048")
    parser.add_argument("--classes", default=CLASSES)
    parser.add_argument("--precision", default="float32")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args(words or None)
    files = sorted(
        (file for dataset in given.datasets for file in find_scans(dataset)),
        key=lambda file: (file.sequence, file.path),
    )
    found: dict[str, Any] = {}
    for width in map(int, given.widths.split(",")):
        weights = weights_file(given.weights)
        settings = NetworkSettings(weights, "cpu", precision=given.precision, width=width)
        space = settings.load().space
        of_drives = drive_scores(settings, files)
        rows = {**of_drives, "all": np.sum([*of_drives.values()], axis=0)}
        found[str(width)] = {}
        for name, confusion in rows.items():
            result = scores(confusion, space)
            ious = {score.name: score.iou for score in result.classes}
            row = {"accuracy": result.accuracy, "miou": result.iou_mean_present}
            row |= {name: ious[name] for name in given.classes.split(",")}
            found[str(width)][name] = {key: round(100 * value, 2) for key, value in row.items()}
            print(width, name, found[str(width)][name], flush=True)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
