# SPDX-License-Identifier: MIT
"""Labels of points of batches are those of the kernels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import on_each_device
from scans import SMALL, make_scan

from salsanext_cli import KnnParameters, knn_refine, project, sensor
from salsanext_cli.core.on_device import knn
from salsanext_cli.core.on_device.projection import project as project_batch

PARAMETERS = [
    KnnParameters(),
    KnnParameters(window=1, k=1),
    KnnParameters(window=3, k=1),
    KnnParameters(window=3, k=9, cutoff=np.inf),
    KnnParameters(window=7, k=4, sigma=3.0, cutoff=0.0),
    KnnParameters(window=9, k=81, cutoff=5.0),
]


def label_images(batch, cell, classes=20, seed=1):
    """Return labels of the pixels of each scan, in patches of a number of pixels."""
    height, width = batch.sensors[0].height, batch.sensors[0].width
    random = np.random.default_rng(seed)
    labels = random.integers(0, classes, (len(batch.counts), height, width), np.uint8)
    return labels[:, ::cell, ::cell].repeat(cell, 1).repeat(cell, 2)[:, :height, :width]


def assert_same_labels(batch, scans, labels, parameters=PARAMETERS[0]):
    found = knn.knn_refine(
        project_batch(batch), torch.from_numpy(labels).to(batch.points.device), parameters
    )
    assert found.dtype == torch.uint8
    images = [project(*pair) for pair in zip(scans, batch.sensors, strict=True)]
    expected = [
        knn_refine(image, label, parameters=parameters)
        for image, label in zip(images, labels, strict=True)
    ]
    np.testing.assert_array_equal(found.cpu().numpy(), np.concatenate(expected))


@on_each_device
@pytest.mark.parametrize("cell", [1, 4])
@pytest.mark.parametrize("parameters", PARAMETERS, ids=str)
def test_scans_of_several_sensors_with_ties(batch_of, scans, sensors, parameters, cell):
    batch = batch_of(scans, sensors)
    assert_same_labels(batch, scans, label_images(batch, cell), parameters)


@on_each_device
@pytest.mark.parametrize("width", [1, 2, 3, 5, 6])
def test_images_that_are_narrower_than_the_window(batch_of, scans, width):
    batch = batch_of(scans, [SMALL.resized(width=width)] * len(scans))
    parameters = KnnParameters(window=7, k=5, cutoff=20.0)
    assert_same_labels(batch, scans, label_images(batch, 1, classes=3), parameters)


@on_each_device
def test_large_windows_are_computed_in_parts(batch_of, monkeypatch):
    monkeypatch.setattr(knn, "CHUNK_CANDIDATES", 2000)
    scans = [make_scan(2000)]
    batch = batch_of(scans, [SMALL])
    assert_same_labels(batch, scans, label_images(batch, 2), KnnParameters(window=11, k=7))


@pytest.mark.real
@on_each_device
@pytest.mark.parametrize("width", [512, 2048])
def test_real_scans(batch_of, hdl64_scans, width):
    batch = batch_of(hdl64_scans, [replace(sensor("hdl64"), width=width)] * len(hdl64_scans))
    for cell in (1, 5):
        assert_same_labels(batch, hdl64_scans, label_images(batch, cell))
