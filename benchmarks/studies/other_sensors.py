# SPDX-License-Identifier: MIT
"""Labels of scans of other sensors than the weights': by view, by gaps between rows.

Scans are sixteen synthetic ones per simulated sensor, two of each of eight streets that no weights
were trained on. With a data set of KITTI's files, laser by laser, also those with every n-th beam
only. Each line is the accuracy and the mean IoU over the classes present in %, the intensity
matched:

weights     in the view of the weights
whole       in the whole view of the sensor
fitted      in the view that `--sensor auto` fits
filled      likewise, gaps between rows filled where training had fewer: what `predict` does

Run: python -m benchmarks.studies.other_sensors [DATASET … --sensors hdl32 vlp16 --weights FILE]
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import salsanext_cli as sn
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.geometry.network_input import with_image_statistics
from salsanext_cli.core.measures.survey import Survey, survey
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.synthesis import drive
from salsanext_cli.synthesis.lidar import Beams, Lasers, Rig, hdl64_rig
from salsanext_cli.training.data.augment import AnnotatedScan

SEED, SEQUENCES, SCANS, SPACING_M = 777, 8, 2, 25.0
SENSORS = {
    "hdl32": (np.linspace(10.67, -30.67, 32), 1090),
    "vlp16": (np.linspace(15, -15, 16), 1800),
    "os0-128": (np.linspace(45, -45, 128), 1024),
    "os1-64": (np.linspace(16.6, -16.6, 64), 1024),
    "os1-128": (np.linspace(22.5, -22.5, 128), 1024),
    "os2-32": (np.linspace(11.25, -11.25, 32), 1024),
}
"""Elevations of the beams in degrees, and firings per revolution."""
COLUMNS = ("weights", "whole", "fitted", "filled")


def simulated(name: str, space: sn.LabelSpace) -> Iterator[AnnotatedScan]:
    """Yield synthetic scans of a sensor with the lasers of an HDL-64 at other elevations."""
    elevations, columns = SENSORS[name]
    count = len(elevations)

    def rig(rng: np.random.Generator) -> Rig:
        usual = hdl64_rig(rng)
        lasers = Lasers(*(np.resize(values, count) for values in usual.beams.lasers))
        start, zero = rng.uniform(0, 2 * np.pi / columns, count), np.zeros(count)
        beams = Beams(
            elevation=np.radians(elevations),
            azimuth=start,
            height=zero,
            aside=zero,
            lasers=lasers,
            columns=columns,
        )
        return replace(usual, beams=beams, unblocked=np.ones(count * columns, bool))

    for sequence in range(SEQUENCES):
        for frame in drive.record(SEED, sequence, SCANS, SPACING_M, rig):
            yield AnnotatedScan(frame.scan, space.to_train(frame.labels))


def thinned(dataset: Path, step: int, space: sn.LabelSpace) -> Iterator[AnnotatedScan]:
    """Yield the scans of KITTI whose 64 lasers follow each other, every so many of them."""
    for path in sorted(dataset.rglob("velodyne/*.bin")):
        scan = sn.read_scan(path)
        left = scan.points[:, 1] >= 0
        laser = np.concatenate([[0], np.cumsum(left[1:] & ~left[:-1])])
        if laser[-1] == 63:
            labels = sn.read_labels(path.parents[1] / "labels" / f"{path.stem}.label")
            kept = np.flatnonzero(laser % step == 0)
            yield AnnotatedScan(scan.take(kept), space.to_train(labels[kept]))


def score(network: Network, scans: list[AnnotatedScan], sensor: Sensor, *, fill: bool) -> str:
    """Return accuracy and mean IoU of the labels in the view of a sensor."""
    images = [sn.project(annotated.scan, sensor) for annotated in scans]
    seen = with_image_statistics(sensor, [image.channels for image in images])
    network = network.for_sensor(seen if fill else replace(seen, row_gaps=None))
    count = network.card.space.class_count
    confusion = np.zeros((count, count), np.int64)
    for image, annotated in zip(images, scans, strict=True):
        labels = sn.knn_refine(image, network.probabilities(image).argmax(0), count)
        np.add.at(confusion, (annotated.labels, labels), 1)
    confusion[0] = 0
    hits, present = np.diag(confusion), confusion.sum(axis=1) > 0
    ious = hits[present] / (confusion.sum(axis=0) + confusion.sum(axis=1) - hits)[present]
    return f"{100 * hits.sum() / confusion.sum():.1f} / {100 * ious.mean():.1f}"


def measure(network: Network, scans: list[AnnotatedScan]) -> list[str]:
    """Return the scores of all columns."""
    usual = replace(network.card.sensor, row_gaps=None, intensity_quantiles=())
    found = fit_view([annotated.scan for annotated in scans], usual)
    surveys = (
        survey(annotated.scan, sn.project(annotated.scan, usual), None) for annotated in scans
    )
    up, down = sum(surveys, start=Survey()).field_of_view()
    views = (usual, replace(usual, fov_up=up, fov_down=down), found)
    plain = [score(network, scans, view, fill=False) for view in views]
    return [*plain, score(network, scans, found, fill=True)]


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("datasets", nargs="*", type=Path)
    parser.add_argument("--sensors", nargs="*", default=[*SENSORS], choices=SENSORS)
    parser.add_argument("--weights", type=Path)
    given = parser.parse_args(words)
    network = sn.load_network(given.weights, "cpu")
    space = network.card.space
    print(f"{'':16}  " + "  ".join(f"{name:>11}" for name in COLUMNS))
    for name in given.sensors:
        row(name, network, list(simulated(name, space)))
    for dataset in given.datasets:
        for step in (1, 2, 3, 4):
            row(f"{dataset.name[:12]} 1/{step}", network, list(thinned(dataset, step, space)))


def row(name: str, network: Network, scans: list[AnnotatedScan]) -> None:
    """Measure some scans and print their line."""
    print(f"{name:16}  " + "  ".join(f"{cell:>11}" for cell in measure(network, scans)), flush=True)


if __name__ == "__main__":
    import sys

    main(*sys.argv[1:])
