# SPDX-License-Identifier: MIT
"""A shorter number type leaves the labels of real scans as they are, but for a few."""

import logging

import numpy as np
import pytest

from salsanext_cli import knn_refine, load_network, project
from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.results.layout import find_scans
from salsanext_cli.training.data.sources import read_labelled


@pytest.mark.slow
@pytest.mark.real
def test_bfloat16_agrees_with_float32(real_data):
    files = [f for f in find_scans(real_data / "data" / "semantickitti") if f.label_path.is_file()]
    networks = {p: load_network(device="cpu", precision=p) for p in ("float32", "bfloat16")}
    space, sensor = networks["float32"].card.space, networks["float32"].sensor
    counts = {name: Confusion(space.class_count) for name in networks}
    agreement, points, differing, clear, differing_clear = [], [], [], 0, 0
    for file in files:
        scan, truth = read_labelled(file, space, sensor)
        image = project(scan, sensor)
        found = {name: network.probabilities(image) for name, network in networks.items()}
        labels = [
            knn_refine(image, each.argmax(axis=0), space.class_count) for each in found.values()
        ]
        for name, each in zip(counts, labels, strict=True):
            counts[name].update(truth, each)
        agreement.append(np.equal(*labels).mean())
        points.append(len(truth))
        full, short = (each[:, image.channels[0] > 0] for each in found.values())
        differing.append(np.abs(full - short).max(axis=0))
        second, largest = np.sort(full, axis=0)[-2:]
        apart = largest - second >= 0.2
        clear += int(apart.sum())
        differing_clear += int((full.argmax(axis=0) != short.argmax(axis=0))[apart].sum())
    iou = {name: 100 * scores(count, space).iou_mean_present for name, count in counts.items()}
    difference = np.quantile(np.concatenate(differing), 0.99)
    same = np.average(agreement, weights=points)
    logging.getLogger(__name__).warning(
        "%.4f of the points agree, of the worst scan %.4f; %d of %d clear pixels differ; 99 %% of "
        "all by at most %.3f; mean IoU %s",
        *(same, min(agreement), differing_clear, clear, difference, iou),
    )
    assert same >= 0.99
    assert min(agreement) >= 0.985
    # A label changes only where two classes are about as probable.
    assert clear > 100_000
    assert differing_clear <= clear / 10_000
    assert difference <= 0.05
    # Of classes with few points, a label more or less counts.
    assert abs(iou["float32"] - iou["bfloat16"]) <= 0.2
