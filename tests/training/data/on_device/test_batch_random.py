# SPDX-License-Identifier: MIT
"""Random numbers of a batch."""

import numpy as np
import pytest
import torch
from scan_stores import CPU

from salsanext_cli.training.data.on_device.batch_random import BatchRandom


def test_a_seed_determines_all_numbers() -> None:
    def numbers(*seed: int) -> list[float]:
        random = BatchRandom.seeded(seed, CPU)
        host = random.host.random(3).tolist()
        return [*host, *random.uniform(2, 2).flatten().tolist(), *random.normal(3).tolist()]

    assert numbers(1, 3, 0, 5) == numbers(1, 3, 0, 5)
    for other in ((1, 3, 0, 6), (1, 3, 1, 5), (2, 3, 0, 5)):
        assert not set(numbers(*other)) & set(numbers(1, 3, 0, 5))


def test_chances_are_shares_and_numbers_of_the_host_are_put_on_the_device() -> None:
    random = BatchRandom.seeded([0], CPU)
    for chance in (0.0, 0.2, 1.0):
        assert random.happens(chance, 4000).mean() == pytest.approx(chance, abs=0.03)
    put = random.put(np.array([1, 2]), torch.int64)
    assert (put.dtype, put.tolist()) == (torch.int64, [1, 2])
    assert random.put([0.5]).dtype == torch.float32
    assert random.put([True, False], torch.bool).tolist() == [True, False]
