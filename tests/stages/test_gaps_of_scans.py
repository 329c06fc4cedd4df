# SPDX-License-Identifier: MIT
"""Stages with scans of fewer beams than those of training."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL, labels_below, write_weights

from salsanext_cli import knn_refine, project, read_scan
from salsanext_cli.formats.kitti import write_bin
from salsanext_cli.geometry.network_input import fill_rows, row_gaps
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans


@pytest.fixture
def knowing(world, tmp_path):
    """Return the world with weights that know the gaps of their training, and fewer beams."""
    weights = write_weights(tmp_path / "knowing.safetensors", sensor=replace(SMALL, row_gaps=0.1))
    for file in sorted(world.data.rglob("*.bin")):
        scan = read_scan(file)
        rows = project(scan, SMALL).pixel_of_point // SMALL.width
        write_bin(file, scan.take(np.flatnonzero(rows % 2)))
        labels = file.parents[1] / "labels" / f"{file.stem}.label"
        labels.write_bytes(np.fromfile(labels, "<u4")[rows % 2 == 1].tobytes())
    return replace(world, network=replace(world.network, weights=weights))


def run(world, out=None, **options):
    return predict_scans(world.data, out or world.out, settings=world.network, **options)


def test_the_network_sees_no_gaps(knowing):
    assert run(knowing).done == 3
    scans = [read_scan(path) for path in sorted(knowing.data.rglob("*.bin"))]
    images = [project(scan, SMALL) for scan in scans]
    recorded = StageRecords(knowing.out).settings("predict")["sensor"]
    assert recorded["row_gaps"] == row_gaps(image.channels for image in images) > 0.3
    network = knowing.network.load()
    space = network.card.space
    for image, content in zip(images, labels_below(knowing.out).values(), strict=True):
        full = replace(image, channels=fill_rows(image.channels))
        labels = knn_refine(image, network.probabilities(full).argmax(0), space.class_count)
        np.testing.assert_array_equal(np.frombuffer(content, "<u4"), space.to_raw(labels))


def test_beams_of_a_sensor_reach_every_stage(world, tmp_path):
    seen = replace(SMALL, beams=(3.0, -1.0, -3.0, -12.0, -25.0))
    network = replace(world.network, sensor=seen)
    predict_scans(world.data, world.out, settings=network)
    assert StageRecords(world.out).settings("predict")["sensor"]["beams"] == list(seen.beams)
    steps = tmp_path / "steps"
    project_scans(world.data, steps, sensor=seen)
    predict_range_images(steps, steps, settings=network)
    knn_refine_scans(steps)
    assert labels_below(steps) == labels_below(world.out)
    image = np.load(next(steps.rglob("range/*.npy")))
    assert (image[0] > 0).any(axis=1).sum() == len(seen.beams)
    predict_scans(world.data, tmp_path / "rows", settings=world.network)
    assert labels_below(tmp_path / "rows") != labels_below(world.out)
