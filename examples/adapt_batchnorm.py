# SPDX-License-Identifier: MIT
"""Measure on labelled scans the gain of `salsanext tune batchnorm` on scans like them.

Adapts to every second scan without using its labels, scores the others, and the reverse. View and
intensity of the scans stay as they are.

Run: python examples/adapt_batchnorm.py dataset/ [hdl64 weights.safetensors [0.1 0.3 1.0]]
"""

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.measures.scan_counts import ScanCounts, count_scan
from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.network.card import default_weights, read_card
from salsanext_cli.results.layout import ScanFile, find_scans
from salsanext_cli.results.selection import space_of
from salsanext_cli.sensors.sensor import sensor
from salsanext_cli.stages.predict import predict_scans
from salsanext_cli.stages.tune import tune


def link(scans: list[ScanFile], folder: Path) -> Path:
    """Make a data set of some scans of another."""
    for scan in scans:
        for file in (scan.path, scan.label_path):
            place = folder / "sequences" / scan.sequence / file.parent.name / file.name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(file.absolute())
    return folder


def count(scans: Path, out: Path, network: NetworkSettings, space: LabelSpace) -> Confusion:
    """Label scans and compare, as `predict` and `eval` do."""
    predict_scans(scans, out, network=network)
    counts = ScanCounts.none(space, by_distance=False)
    for scan in find_scans(scans):
        counts.add(count_scan(scan, out, space))
    return counts.confusion


def main(dataset: str, sensor_name: str = "", weights: str = "", *shares: str) -> None:
    before = Path(weights) if weights else default_weights()
    card, scans = read_card(before), find_scans(Path(dataset))
    space, own = space_of(scans, card.space), sensor(sensor_name) if sensor_name else None
    print("share  mIoU %  accuracy %")
    for share in (0.0, *map(float, shares or ("0.1", "0.2", "0.3", "0.5", "0.7", "1.0"))):
        total = Confusion(space.class_count)
        with TemporaryDirectory() as folder:
            halves = [link(scans[i::2], Path(folder) / f"half{i}") for i in (0, 1)]
            for number, (adapting, scoring) in enumerate((halves, halves[::-1])):
                network = NetworkSettings(before, sensor=own, fit=False, intensity="raw")
                if share:
                    adapted = Path(folder) / f"{number}.safetensors"
                    tune("batchnorm", adapting, adapted, network=network, share=share)
                    # The adapted weights know their sensor.
                    network = replace(network, weights=adapted, sensor=None)
                total += count(scoring, Path(folder) / f"out{number}", network, space)
        found = scores(total, space)
        print(f"{share:5.2f}  {100 * found.iou_mean_present:6.1f}  {100 * found.accuracy:10.1f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
