# SPDX-License-Identifier: MIT
import math

import pytest
import torch
from tiny_network import TinyNetwork

from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.non_finite import non_finite_samples


@pytest.mark.parametrize("bad", [[], [1], [0, 3]])
def test_images_are_tried_alone_and_by_their_own_statistics(bad: list[int]) -> None:
    module, loss = TinyNetwork(3), SegmentationLoss(torch.tensor([0.0, 1.0, 1.0]))
    images = torch.randn(4, 5, 8, 16)
    truth = torch.ones(4, 8, 16, dtype=torch.uint8)
    images[bad, 2, 3, 3] = math.inf
    module.norm.running_mean.fill_(math.nan)  # as a step with such an image leaves it
    before = {name: values.clone() for name, values in module.state_dict().items()}
    assert non_finite_samples(module.train(), loss, images, truth) == bad
    assert module.training
    for name, values in module.state_dict().items():
        torch.testing.assert_close(values, before[name], equal_nan=True)
