# SPDX-License-Identifier: MIT
"""Scans that are drawn for a batch."""

import numpy as np
import pytest
from scan_stores import batch_random

from salsanext_cli.training.data.on_device.drawn_scans import draw_partners, draw_scans
from salsanext_cli.training.recipe import Recipe


def test_partners_are_other_scans_of_one_data_set_drawn_evenly() -> None:
    index = np.repeat(np.arange(4), 1000)
    partners = draw_partners(index, [4], 0.5, np.random.default_rng(0))
    assert (partners != index).all()
    for scan in range(4):
        counts = np.bincount(partners[index == scan], minlength=4)
        assert np.delete(counts, scan).min() > 270
    assert draw_partners(np.array([0]), [1], 0.5, np.random.default_rng(0)).tolist() == [0]


def test_partners_are_of_further_data_sets_as_often_as_samples_are() -> None:
    index = np.repeat([1, 5], 2000)
    partners = draw_partners(index, [3, 2, 4], 0.4, np.random.default_rng(1))
    assert (partners != index).all()
    source = np.digitize(partners, [3, 5])
    shares = np.bincount(source) / len(source)
    assert shares == pytest.approx([0.6, 0.2, 0.2], abs=0.04)
    # Of its own data set a scan draws the other ones, of another one all.
    assert set(partners[(index == 1) & (source == 0)]) == {0, 2}
    assert set(partners[(index == 5) & (source == 0)]) == {0, 1, 2}
    assert set(partners[(index == 5) & (source == 2)]) == {6, 7, 8}


def test_scans_of_a_batch_are_those_of_its_images_then_mixed_then_pasted_ones() -> None:
    first = np.array([4, 0, 2])
    alone = draw_scans(first, [5], Recipe(), batch_random())
    assert alone.whole.tolist() == [4, 0, 2]
    assert not len(alone.pasted)
    assert not alone.is_mixed.any()
    both = draw_scans(first, [5], Recipe(mix=1.0, paste=1.0), batch_random())
    assert both.whole[:3].tolist() == [4, 0, 2]
    assert both.image_of_scan.tolist() == [0, 1, 2, 0, 1, 2, 0, 1, 2]
    assert both.is_mixed.tolist() == 3 * [False] + 3 * [True] + 3 * [False]
    assert (len(both.whole), len(both.pasted), both.count) == (6, 3, 9)
    drawn = [
        draw_scans(np.zeros(20, int), [5], Recipe(mix=0.3), batch_random(s)) for s in range(50)
    ]
    mixed = np.mean([scans.is_mixed.sum() / 20 for scans in drawn])
    assert mixed == pytest.approx(0.3, abs=0.07)
