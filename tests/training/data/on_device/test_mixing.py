# SPDX-License-Identifier: MIT
"""Mixing and pasting in a batch, beside the checkerboards of one scan on the CPU."""

import numpy as np
import pytest
import torch
from scan_stores import CPU, batch_random, stored
from scans import SMALL, make_scan

from salsanext_cli.training.data.augment import CLEAR_RADIUS_M, PASTED_COPIES, Checkerboard
from salsanext_cli.training.data.on_device.drawn_scans import DrawnScans
from salsanext_cli.training.data.on_device.mixing import Checkerboards, mix, paste
from salsanext_cli.training.data.on_device.point_batch import PointBatch

BOARDS = [(4, 1), (6, 1), (1, 2), (1, 6), (2, 2), (3, 4), (5, 6), (1, 1)]


def test_odd_points_are_those_of_one_board() -> None:
    scans = [make_scan(800, seed) for seed in range(len(BOARDS))]
    batch = PointBatch.from_scans([stored(scan) for scan in scans], CPU)
    bands, sectors = np.array(BOARDS).T
    azimuths = np.linspace(-3.1, 2.9, len(BOARDS))
    boards = Checkerboards.from_numbers(bands, sectors // 2, azimuths, SMALL)
    odd = boards.odd(batch.points, batch.scan_of_point, batch_random())
    for number, azimuth in enumerate(azimuths):
        board = Checkerboard(
            bands=int(bands[number]),
            sectors=int(sectors[number]),
            azimuth=azimuth,
            fov_down=SMALL.fov_down,
            fov_up=SMALL.fov_up,
        )
        is_scan = batch.scan_of_point == number
        expected = board.odd(batch.points[is_scan].numpy())
        assert (odd[is_scan].numpy() == expected).mean() > 0.998
        assert (0.1 < expected.mean() < 0.9) == (number < len(BOARDS) - 1)


def test_boards_are_drawn_as_those_of_one_scan() -> None:
    boards = Checkerboards.random(3000, SMALL, np.random.default_rng(0))
    bands = 1 + np.isfinite(boards.slopes).sum(axis=1)
    pairs = boards.planes.any(axis=2).sum(axis=1)
    drawn = [Checkerboard.random(SMALL, np.random.default_rng(seed)) for seed in range(3000)]
    expected_bands = np.array([board.bands for board in drawn])
    expected_sectors = np.array([board.sectors for board in drawn])
    for found, expected, values in (
        (bands, expected_bands, range(1, 7)),
        (2 * pairs + (pairs == 0), expected_sectors, (1, 2, 4, 6)),
    ):
        for value in values:
            share = np.mean(expected == value)
            assert share > 0.05
            assert np.mean(found == value) == pytest.approx(share, abs=0.05)
        assert set(found) == set(values)


def test_an_image_has_the_even_cells_of_one_scan_and_the_odd_ones_of_another() -> None:
    """The second image is not mixed, and a third scan is pasted into the first."""
    scans = [stored(make_scan(500, seed)) for seed in range(4)]
    drawn = DrawnScans(
        whole=np.array([0, 1, 2]),
        pasted=np.array([3]),
        image_of_scan=np.array([0, 1, 0, 0]),
        is_mixed=np.array([False, False, True, False]),
    )
    batch = PointBatch.from_scans(scans, CPU)
    mixed = mix(batch, drawn, SMALL, batch_random(1))
    boards = Checkerboards.random(2, SMALL, batch_random(1).host)
    odd = boards.odd(batch.points, torch.zeros(2000, dtype=torch.int64), batch_random())
    expected = torch.cat([~odd[:500], torch.ones(500, dtype=torch.bool), odd[1000:1500]])
    assert torch.equal(mixed.is_shown[:1500], expected)
    assert mixed.is_shown[1500:].all()
    assert 0 < expected[:500].sum() < 500


def test_pasted_points_are_copies_turned_about_z_outside_of_the_clear_radius() -> None:
    scans = [stored(make_scan(100, seed)) for seed in range(3)]
    batch = PointBatch.from_scans(scans, CPU)
    pasted = paste(batch, 200, 3, batch_random())
    assert torch.equal(pasted.points[:200], batch.points[:200])
    flat = torch.hypot(*batch.points[200:, :2].T)
    angles = []
    for copy in range(PASTED_COPIES):
        part = pasted.part(slice(200 + 100 * copy, 300 + 100 * copy))
        torch.testing.assert_close(torch.hypot(*part.points[:, :2].T), flat)
        torch.testing.assert_close(part.points[:, 2], batch.points[200:, 2])
        turned = torch.atan2(*part.points[:, :2].flip(1).T) - torch.atan2(
            *batch.points[200:, :2].flip(1).T
        )
        angles.append(turned.cos().mean())
        assert turned.cos().std() < 1e-4
        assert torch.equal(part.targets, batch.targets[200:])
        assert torch.equal(part.is_shown, flat > CLEAR_RADIUS_M)
    assert len(pasted.points) == 200 + 100 * PASTED_COPIES
    assert angles[0] != angles[1]
    nothing = paste(batch, 300, 3, batch_random())
    assert torch.equal(nothing.points, batch.points)
