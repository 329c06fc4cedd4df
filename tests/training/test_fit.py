# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
from scans import SMALL, write_sequence

from salsanext_cli import knn_refine, load_network, project
from salsanext_cli.formats.kitti import read_bin, read_labels
from salsanext_cli.results.layout import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.validation import validate


def test_scores_count_points_after_knn(tmp_path: Path, weights: Path) -> None:
    """Every point of every scan is counted, not every pixel."""
    files = find_scans(write_sequence(tmp_path / "08", ["a", "b", "c"]))
    network = load_network(weights, "cpu")
    assert network.sensor == SMALL
    space = network.card.space
    expected = np.zeros((20, 20), int)
    for file in files:
        image = project(read_bin(file.path), SMALL)
        predicted = knn_refine(image, network.probabilities(image).argmax(0))
        truth = space.to_train(read_labels(file.label_path))
        np.add.at(expected, (truth, predicted), 1)
    confusion = validate(network, Source(files, network.card.space, network.sensor)).confusion
    np.testing.assert_array_equal(confusion.matrix, expected)
    assert confusion.matrix.sum() == 4500
