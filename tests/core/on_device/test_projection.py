# SPDX-License-Identifier: MIT
"""Range images of batches have the bits of the kernels."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from devices import on_each_device

from salsanext_cli import RangeImage, Scan, Sensor, project, sensor
from salsanext_cli.core.geometry import projection as kernels
from salsanext_cli.core.on_device.projection import RangeImages, arctan2
from salsanext_cli.core.on_device.projection import project as project_batch


def assert_same(images: RangeImages, expected: Sequence[RangeImage]) -> None:
    pixels = expected[0].height * expected[0].width
    counts = [len(image.point_range) for image in expected]
    channels = np.stack([image.channels for image in expected])
    np.testing.assert_array_equal(images.channels.cpu().numpy(), channels)
    found_pixels = images.pixel_of_point.cpu().split(counts)
    found_ranges = images.point_range.cpu().split(counts)
    begin = np.cumsum([0, *counts])
    for number, image in enumerate(expected):
        nearest = np.where(
            image.point_of_pixel < 0, begin[-1], image.point_of_pixel + begin[number]
        )
        np.testing.assert_array_equal(images.point_of_pixel[number].cpu(), nearest)
        own = image.pixel_of_point.astype(np.int64)
        own[own >= 0] += number * pixels
        np.testing.assert_array_equal(found_pixels[number], own)
        np.testing.assert_array_equal(found_ranges[number], image.point_range)


def projected(scans: Sequence[Scan], sensors: Sequence[Sensor]) -> list[RangeImage]:
    return [project(*pair) for pair in zip(scans, sensors, strict=True)]


@on_each_device
def test_scans_of_several_sensors_with_ties(batch_of, scans, sensors):
    assert_same(project_batch(batch_of(scans, sensors)), projected(scans, sensors))


@on_each_device
def test_a_scan_without_points_has_an_empty_image(batch_of, scans, sensors):
    assert not len(scans[2])
    images = project_batch(batch_of(scans[2:3], sensors[:1]))
    assert not images.occupied.any()
    assert len(images.pixel_of_point) == 0


@on_each_device
def test_points_on_the_borders_of_pixels(batch_of):
    """Directions at the corners of all pixels, and the floats beside them."""
    hdl64 = replace(sensor("hdl64"), width=512)
    yaw = np.pi * (1 - 2 * np.arange(512) / 512)
    steps = np.arange(hdl64.height + 1) / hdl64.height
    pitch = np.radians(hdl64.fov_up) - steps * np.radians(hdl64.fov_up - hdl64.fov_down)
    yaw, pitch = (angles.ravel() for angles in np.meshgrid(yaw, pitch))
    exact = np.stack(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1
    )
    points = (20 * exact).astype(np.float32)
    points = np.concatenate([points, np.nextafter(points, np.float32(0)), 2 * points])
    scan = Scan(points, np.ones(len(points), np.float32))
    assert_same(project_batch(batch_of([scan], [hdl64])), projected([scan], [hdl64]))


@on_each_device
def test_the_arctangent_has_the_bits_of_the_kernel(device):
    y, x = np.random.default_rng(5).normal(size=(2, 20_000))
    x[:6], y[:6] = (0, -0.0, 0, 1, -0.0, -1), (0, 0.0, -1, 0, -0.0, -0.0)
    tensors = (torch.from_numpy(values).to(device) for values in (y, x))
    expected = np.array([kernels.arctan2(*pair) for pair in zip(y, x, strict=True)])
    found = arctan2(*tensors).cpu().numpy()
    np.testing.assert_array_equal(found.view(np.int64), expected.view(np.int64))


@pytest.mark.real
@on_each_device
@pytest.mark.parametrize("width", [512, 2048])
def test_real_scans(batch_of, hdl64_scans, width):
    sensors = [replace(sensor("hdl64"), width=width)] * len(hdl64_scans)
    images = project_batch(batch_of(hdl64_scans, sensors))
    assert_same(images, projected(hdl64_scans, sensors))
