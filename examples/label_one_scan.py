# SPDX-License-Identifier: MIT
"""Label one scan, write the labels, and count the points of each class.

Run: python examples/label_one_scan.py 000000.bin [weights.safetensors]
"""

import sys
from pathlib import Path

import numpy as np

import salsanext_cli as sn


def main(scan_file: str, weights: str | None = None) -> None:
    scan = sn.read_scan(scan_file)
    network = sn.fit_network(sn.load_network(weights), [scan])
    image = sn.project(scan, network.sensor)
    probabilities = network.probabilities(image)
    labels = sn.knn_refine(image, probabilities.argmax(axis=0), len(probabilities))

    space = network.card.space
    sn.write_labels(Path(scan_file).with_suffix(".label"), space.to_raw(labels))
    counts = np.bincount(labels, minlength=space.class_count)
    for train_id in np.argsort(counts)[::-1]:
        if counts[train_id]:
            print(f"{counts[train_id]:8d}  {space.names[train_id]}")


if __name__ == "__main__":
    main(*sys.argv[1:])
