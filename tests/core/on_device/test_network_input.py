# SPDX-License-Identifier: MIT
"""Inputs of a network are those of single images."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import on_each_device
from scans import SMALL

from salsanext_cli import Scan, project
from salsanext_cli.core.geometry.intensity import NO_INTENSITY
from salsanext_cli.core.geometry.network_input import network_input
from salsanext_cli.core.on_device.intensity import interpolated
from salsanext_cli.core.on_device.network_input import network_inputs
from salsanext_cli.core.on_device.projection import project as project_batch
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS

RISING = tuple(np.linspace(0, 1, INTENSITY_LEVELS).tolist())
IN_STEPS = tuple(np.round(np.linspace(0, 1, INTENSITY_LEVELS), 1).tolist())
SQUARES = tuple(np.square(np.linspace(0, 3, INTENSITY_LEVELS)).tolist())


def assert_same_inputs(batch, scans, trained):
    found = network_inputs(project_batch(batch).channels, batch.sensors, trained)
    expected = [
        network_input(project(scan, own).channels, own, trained)
        for scan, own in zip(scans, batch.sensors, strict=True)
    ]
    np.testing.assert_array_equal(found.cpu().numpy(), np.concatenate(expected))


@on_each_device
@pytest.mark.parametrize("target", [(), RISING, SQUARES, NO_INTENSITY], ids=len)
def test_intensities_are_matched_as_in_single_images(batch_of, scans, sensors, target):
    """Sensors without quantiles, with those of training, and with equal ones."""
    quantiles = [(), RISING, IN_STEPS, SQUARES, NO_INTENSITY]
    members = [
        replace(sensor, intensity_quantiles=values, means=(10.0, 0.5, 0.3, -1.0, 0.1 * number))
        for number, (sensor, values) in enumerate(zip(sensors, quantiles, strict=True))
    ]
    trained = replace(SMALL, intensity_quantiles=target)
    assert_same_inputs(batch_of(scans, members), scans, trained)


@on_each_device
def test_images_without_an_intensity(batch_of, scans, sensors):
    """Values that follow the range, and equal ones, are mapped to the mean of training."""
    ranges = np.linalg.norm(scans[0].points, axis=1).astype(np.float32)
    copies = [Scan(scans[0].points, ranges), Scan(scans[0].points, np.full_like(ranges, 0.5))]
    members = [replace(SMALL, intensity_quantiles=RISING)] * 2
    trained = replace(SMALL, intensity_quantiles=SQUARES)
    assert_same_inputs(batch_of(copies, members), copies, trained)


@on_each_device
def test_gaps_are_filled_where_a_sensor_has_more(batch_of, scans, sensors):
    gaps = [None, 0.5, 0.1, 0.5, 0.15]
    members = [replace(sensor, row_gaps=share) for sensor, share in zip(sensors, gaps, strict=True)]
    assert_same_inputs(batch_of(scans, members), scans, replace(SMALL, row_gaps=0.1))


@on_each_device
def test_interpolation_is_that_of_numpy(device):
    random = np.random.default_rng(3)
    values = np.stack([np.sort(random.random(9)), np.array([0.25] * 5 + [0.25] * 4)])
    values[0, -3:] = values[0, -3]
    targets = random.random((2, 9))
    targets[0, -3:] = targets[0, -3]
    targets[1] = 0.75
    x = np.concatenate([random.uniform(-1, 2, 500), values[0]]).astype(np.float32)
    found = interpolated(
        torch.from_numpy(np.stack([x, x])).to(device),
        torch.from_numpy(values).to(device),
        torch.from_numpy(targets).to(device),
    )
    tables = (np.unique(np.stack(table), axis=1) for table in zip(values, targets, strict=True))
    expected = [np.interp(x, *table) for table in tables]
    np.testing.assert_array_equal(found.cpu().numpy(), np.float32(expected))
