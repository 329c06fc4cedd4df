# SPDX-License-Identifier: MIT
"""Regions of a batch are those of the kernel, once enough rounds have joined them."""

import numpy as np
import pytest
import torch
from devices import on_each_device

from salsanext_cli.core.on_device.regions import EMPTY, Regions
from salsanext_cli.core.uncertainty.error_features import mean_of_regions

SIZE = (16, 64)


def snake() -> np.ndarray:
    """Return a region of one path through the image, three rows apart, so that it has no loop."""
    classes = np.full(SIZE, EMPTY)
    classes[::3, 3:-3] = 1
    for number, row in enumerate(range(0, SIZE[0] - 3, 3)):
        classes[row : row + 4, -4 if number % 2 else 3] = 1
    return classes


@pytest.fixture
def classes() -> np.ndarray:
    """Return the classes of a snake, of patches and of an empty image, (3, H, W)."""
    random = np.random.default_rng(1)
    patches = random.integers(0, 2, SIZE)[:, ::4].repeat(4, axis=1)
    patches[random.random(SIZE) < 0.2] = EMPTY
    return np.stack([snake(), patches, np.full(SIZE, EMPTY)])


@on_each_device
def test_means_are_those_of_the_kernel(classes, device):
    values = np.random.default_rng(2).random(classes.shape, np.float32)
    regions = Regions.from_classes(torch.from_numpy(classes).to(device), 40)
    assert regions.is_whole.tolist() == [True] * len(classes)
    found = regions.means(torch.from_numpy(values).to(device).reshape(-1)).cpu().numpy()
    for classes_of_image, value, mean in zip(
        classes, values, found.reshape(values.shape), strict=True
    ):
        expected = np.zeros_like(value)
        occupied = classes_of_image != EMPTY
        mean_of_regions(occupied, classes_of_image.astype(np.uint8), value, expected)
        np.testing.assert_allclose(mean, expected, rtol=1e-6)


@on_each_device
def test_an_image_shows_whether_its_regions_are_whole(classes, device):
    there = torch.from_numpy(classes).to(device)
    assert Regions.from_classes(there, 1).is_whole.tolist() == [False, False, True]
    needed = [
        next(n for n in range(1, 40) if Regions.from_classes(image[None], n).is_whole.all())
        for image in there
    ]
    assert needed[0] > needed[1] > needed[2] == 1
    rounds = needed[1]
    assert Regions.from_classes(there, rounds).is_whole.tolist() == [False, True, True]
