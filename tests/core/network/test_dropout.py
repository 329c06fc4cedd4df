# SPDX-License-Identifier: MIT
"""Dropout of whole channels."""

import pytest
import torch

from salsanext_cli.core.network.dropout import ChannelDropout, random_masks, sampling


def test_dropout_takes_whole_channels_keeps_the_expectation_and_is_off_otherwise():
    layer = ChannelDropout(0.3)
    generators = [torch.Generator().manual_seed(seed) for seed in range(4000)]
    with sampling(random_masks(generators)):
        dropped = layer(torch.ones(4000, 3, 2, 2))
    assert torch.equal(dropped, dropped[:, :, :1, :1].expand_as(dropped))
    assert dropped.mean().item() == pytest.approx(1, abs=0.02)
    assert (dropped == 0).float().mean().item() == pytest.approx(0.3, abs=0.02)
    assert dropped.max().item() == pytest.approx(1 / 0.7)
    layer = ChannelDropout(0.5).eval()
    x = torch.ones(1, 8, 2, 2)
    assert torch.equal(layer(x), x)
    with pytest.raises(ZeroDivisionError), sampling(random_masks([torch.Generator()])):
        raise ZeroDivisionError
    assert torch.equal(layer(x), x)
    layer.train()
    torch.manual_seed(0)
    assert not torch.equal(layer(x), x)
