# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
from scans import SMALL, write_sequence

from salsanext_cli import knn_refine, load_network, project
from salsanext_cli.formats.kitti import read_bin
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.results.layout import find_scans
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.fit import validate


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
    assert expected.sum() == 4500
    wanted = scores(Confusion(20, expected), space)
    row = validate(network, Source(files, space, network.sensor))
    assert (row["accuracy"], row["miou"]) == (wanted.accuracy, wanted.iou_mean_present)
    np.testing.assert_equal(
        [row[f"iou_{s.name}"] for s in wanted.classes], [s.iou for s in wanted.classes]
    )
