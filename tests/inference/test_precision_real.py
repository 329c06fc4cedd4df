# SPDX-License-Identifier: MIT
"""A shorter number type leaves the labels of real scans as they are, but for a few."""

import logging

import numpy as np
import pytest

from salsanext_cli import knn_refine, load_network, project
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import scores
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.training.data.sources import read_labelled


@pytest.mark.slow
@pytest.mark.real
def test_bfloat16_agrees_with_float32(real_data):
    files = [f for f in find_scans(real_data / "data" / "semantickitti") if f.label_path.is_file()]
    networks = {p: load_network(device="cpu", precision=p) for p in ("float32", "bfloat16")}
    space, sensor = networks["float32"].card.space, networks["float32"].sensor
    counts = {name: Confusion(space.class_count) for name in networks}
    same = points = 0
    for file in files:
        scan, truth = read_labelled(file, space, sensor)
        image = project(scan, sensor)
        found = {}
        for name, network in networks.items():
            pixel_labels = network.probabilities(image).argmax(axis=0)
            found[name] = knn_refine(image, pixel_labels, space.class_count)
            counts[name].update(truth, found[name])
        same += int(np.equal(*found.values()).sum())
        points += len(truth)
    iou = {name: 100 * scores(count, space).iou_mean_present for name, count in counts.items()}
    logging.getLogger(__name__).warning(
        "%.4f of %d points agree, mean IoU %s", same / points, points, iou
    )
    assert same / points >= 0.995
    assert abs(iou["float32"] - iou["bfloat16"]) <= 0.1
