# SPDX-License-Identifier: MIT
"""The running average moves towards the network in training, all of it."""

import pytest
from torch import nn

from salsanext_cli.training.running_average import RunningAverage


def test_the_average_includes_batch_norm_and_soon_leaves_the_initial_weights() -> None:
    average, new = nn.BatchNorm2d(1), nn.BatchNorm2d(1)
    slow = RunningAverage(average, new, 0.9)
    new.weight.data.fill_(3.0)
    new.running_mean.fill_(1.0)
    new.num_batches_tracked.fill_(7)
    slow.update(1000)
    assert float(average.weight.detach()) == pytest.approx(1.2)
    assert float(average.running_mean) == pytest.approx(0.1)
    assert int(average.num_batches_tracked) == 7
    fast = RunningAverage(average, new, 0.999)
    for step in range(30):
        fast.update(step)
    assert float(average.weight.detach()) > 2.98


def test_a_network_without_counts_is_averaged() -> None:
    average, new = nn.Linear(1, 1), nn.Linear(1, 1)
    new.weight.data.fill_(3.0)
    RunningAverage(average, new, 0.0).update(0)
    assert float(average.weight.detach()) == 3
