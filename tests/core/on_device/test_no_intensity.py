# SPDX-License-Identifier: MIT
"""Values of a batch that are no intensities are those of single images."""

import numpy as np
import torch
from devices import on_each_device

from salsanext_cli.core.geometry.intensity import SAMPLE, why_no_intensity
from salsanext_cli.core.on_device.no_intensity import lack_intensity
from salsanext_cli.core.on_device.pixel_sample import PixelSample

COUNTS = (0, 1, 50, 99, 100, 500, SAMPLE)


def images() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return points and values of images, of which some follow a property of the points."""
    random = np.random.default_rng(0)
    found = []
    for number in range(84):
        count = COUNTS[number % len(COUNTS)]
        points = random.normal(size=(count, 3)).astype(np.float32)
        x, y, z = points.T
        ranges = np.linalg.norm(points, axis=1)
        followed = [ranges, z / ranges, np.arctan2(y, x), np.arange(count)][number // 7 % 4]
        noise = [0.0, 0.02, 0.2, 5.0][number // 28]
        values = followed + noise * followed.std() * random.normal(size=count) if count else y
        if number % 5 == 0:  # Most are equal
            values = np.where(random.random(count) < 0.95, 0.5, values)
        found.append((points, values.astype(np.float32)))
    return found


@on_each_device
def test_decisions_are_those_of_single_images(device):
    found = images()
    points = torch.full((len(found), 3, SAMPLE), torch.nan)
    intensity = torch.full((len(found), SAMPLE), torch.nan)
    for number, (coordinates, values) in enumerate(found):
        points[number, :, : len(values)] = torch.from_numpy(coordinates.T)
        intensity[number, : len(values)] = torch.from_numpy(values)
    counts = torch.tensor([[len(values)] for _, values in found])
    sample = PixelSample(
        points=points.to(device), intensity=intensity.to(device), counts=counts.to(device)
    )
    expected = [bool(why_no_intensity(*image)) for image in found]
    assert lack_intensity(sample).tolist() == expected
    assert 0.2 < np.mean(expected) < 0.8
