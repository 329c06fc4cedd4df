# SPDX-License-Identifier: MIT
"""Labels of scans that lie elsewhere in their frame than at the sensor, or upside down in it.

Each scan is turned about z, leant by up to 3°, in every third case turned upside down, and moved by
some metres in a random direction, and by up to 3 m in height. A line has the accuracy of its labels
in %, if labels of SemanticKITTI's classes lie beside it. Else it has the share of the points with
the label of the scan as it is. `said` marks a warning that withholds the estimated accuracy.

Run: python -m benchmarks.studies.displaced SCAN_OR_FOLDER …
     [--metres 0 1 5 20 100] [--weights FILE]
"""

import argparse
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

import salsanext_cli as sn
from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.measures.expected_accuracy import WITHHELD_FOR
from salsanext_cli.runs.fit.sensor_fit import fit_network
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans

SEED, MAX_HEIGHT_M, MAX_LEAN_DEG, UPSIDE_DOWN = 777, 3.0, 3.0, 1 / 3
METRES = (0.0, 1.0, 5.0, 20.0, 30.0, 100.0, 500.0)


def displaced(scan: sn.Scan, metres: float, random: np.random.Generator) -> sn.Scan:
    """Return a scan in another frame; the same for a distance of 0."""
    if not metres:
        return scan
    yaw, lean = random.uniform(-np.pi, np.pi), np.radians(random.uniform(-1, 1) * MAX_LEAN_DEG)
    around = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    aside = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    side = np.diag([1, -1, -1]) if random.random() < UPSIDE_DOWN else np.eye(3)
    angle = random.uniform(-np.pi, np.pi)
    height = random.uniform(-MAX_HEIGHT_M, MAX_HEIGHT_M)
    shift = np.array([metres * np.cos(angle), metres * np.sin(angle), height])
    points = (scan.points @ (around @ aside @ side).T + shift).astype(np.float32)
    points[~scan.points.any(axis=1)] = 0
    return sn.Scan(points, scan.intensity)


def labelled(file: ScanFile, scan: sn.Scan, network: Network) -> tuple[npt.NDArray[np.uint8], bool]:
    """Return the labels (N,) of a scan, and whether a warning withholds the estimate."""
    trained = network.card.sensor
    network = fit_network(network, [scan])
    sensor = sensor_of(scan, network.sensor)
    try:
        check = check_scan(file.path, scan, sensor, trained)
    except sn.SalsanextError:
        return np.zeros(len(scan), np.uint8), True
    image = sn.project(scan, sensor)
    pixels = network.for_sensor(sensor).probabilities(image).argmax(axis=0)
    labels = sn.knn_refine(image, pixels, network.card.space.class_count)
    return labels, any(finding.code in WITHHELD_FOR for finding in check.findings)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--metres", nargs="*", type=float, default=METRES)
    parser.add_argument("--weights", type=Path)
    options = parser.parse_args(words)
    network = sn.load_network(options.weights, "cpu")
    print(f"{'':32}" + "".join(f"{f'{metres:g} m':>14}" for metres in options.metres))
    for file in (file for source in options.sources for file in find_scans(source)):
        scan = sn.read_scan(file.path)
        truth, _ = labelled(file, scan, network)
        if file.label_path.exists():
            with suppress(sn.SalsanextError):  # Ids of another label space
                truth = network.card.space.to_train(sn.read_labels(file.label_path))
        cells = []
        for number, metres in enumerate(options.metres):
            random = np.random.default_rng([SEED, number])
            labels, is_said = labelled(file, displaced(scan, metres, random), network)
            share = float((labels == truth)[truth > 0].mean())
            cells.append(f"{100 * share:.1f}{' said' if is_said else '     '}")
        name = f"{file.path.parent.name}/{file.path.name}"[-32:]
        print(f"{name:32}" + "".join(f"{cell:>14}" for cell in cells), flush=True)


if __name__ == "__main__":
    import sys

    main(*sys.argv[1:])
