# SPDX-License-Identifier: MIT
"""The network has a logit per class and pixel, whatever the size of the image."""

import pytest
import torch
from scans import salsanext_of

from salsanext_cli.core.network.registry import build

NARROW = {"context_width": 4, "widths": (4, 4, 4, 4, 4), "decoder_widths": (4, 4, 4, 4)}
SIZES = [(16, 64), (17, 80), (32, 96)]


@pytest.fixture(scope="module")
def module():
    with salsanext_of(**NARROW):
        return build({"name": "salsanext", "class_count": 5}).eval()


def logits(module, image: torch.Tensor) -> torch.Tensor:
    with torch.inference_mode():
        return module(image)


@pytest.mark.parametrize("size", SIZES)
def test_each_pixel_has_a_logit_per_class(module, size):
    assert logits(module, torch.zeros(2, 5, *size)).shape == (2, 5, *size)


def test_images_of_a_batch_do_not_change_each_other(module):
    images = torch.randn(3, 5, 16, 64, generator=torch.Generator().manual_seed(1))
    whole = logits(module, images)
    for number in range(3):
        alone = logits(module, images[number : number + 1])
        torch.testing.assert_close(whole[number : number + 1], alone, atol=1e-5, rtol=1e-5)
