# SPDX-License-Identifier: MIT
"""Changes of the images of a batch, beside those of one image on the CPU."""

import numpy as np
import pytest
import torch
from scan_stores import batch_random

from salsanext_cli.core.geometry import row_gaps
from salsanext_cli.training.data import other_sensors
from salsanext_cli.training.data.on_device.image_changes import (
    columns_of,
    drawn_rows,
    fill_rows,
    hole_cells,
    make_holes,
    row_gap_shares,
    window_columns,
)


def images(seed: int, empty: float = 0.5, shape: tuple[int, ...] = (3, 6, 12, 40)) -> torch.Tensor:
    """Return images whose ranges have steps, some of them empty."""
    random = np.random.default_rng(seed)
    values = random.uniform(1, 2, shape).astype(np.float32)
    ranges = random.choice([3.0, 3.2, 5.0, 7.0, 15.0, 30.0, 60.0, 90.0], values[:, 0].shape)
    values[:, 0] = ranges
    is_empty = random.random(values[:, 0].shape) < empty
    return torch.from_numpy(np.where(is_empty[:, None], np.float32(0), values))


@pytest.mark.parametrize("seed", range(4))
def test_cells_of_holes_are_those_of_one_image(seed: int) -> None:
    ranges = images(seed)[:, 0]
    expected = [other_sensors.hole_cells(image.numpy()) for image in ranges]
    np.testing.assert_array_equal(hole_cells(ranges), expected)


def test_pixels_are_lost_with_the_share_of_their_cell_and_the_factor_of_their_image() -> None:
    before = images(1, 0.1, (3, 2, 64, 512))
    factors = np.array([0.0, 0.5, 2.0])
    after = make_holes(before, factors, batch_random(1))
    is_lost = (after[:, 0] == 0).numpy()
    assert torch.equal(after[0], before[0])
    assert torch.equal(after, before.masked_fill(torch.from_numpy(is_lost)[:, None], 0))
    cells = hole_cells(before[:, 0]).numpy()
    for number, factor in enumerate(factors):
        for cell, share in enumerate(other_sensors.HOLE_SHARES.ravel()):
            of_cell = is_lost[number][(cells[number] == cell) & (before[number, 0].numpy() > 0)]
            # Runs make the mean vary as that of fewer pixels would.
            spread = 5 * np.sqrt(2.5 * factor * share / len(of_cell))
            assert of_cell.mean() == pytest.approx(factor * share, abs=spread + 1e-9)


def test_holes_of_one_surface_come_in_runs() -> None:
    lost = (
        make_holes(torch.full((1, 1, 400, 512), 7.0), np.array([2.4]), batch_random(5))[0, 0] == 0
    )
    continued = lost[:, 1:][lost[:, :-1]].float().mean().item()
    share = other_sensors.CONTINUED
    assert continued == pytest.approx(share + (1 - share) * lost.float().mean().item(), abs=0.02)


def test_rows_of_fewer_beams_are_evenly_spaced_or_random() -> None:
    rows = drawn_rows(400, 64, np.random.default_rng(0))
    counts = rows.sum(axis=1)
    assert counts.min() >= other_sensors.MIN_ROWS * 64
    assert counts.max() <= other_sensors.MAX_ROWS * 64
    assert np.ptp(counts) > 28
    # Even rows are as far from each other as their number asks, random ones are not.
    is_even = []
    for row, count in zip(rows, counts, strict=True):
        steps = np.diff(np.flatnonzero(row))
        is_even.append(steps.max() <= np.ceil(64 / count) and steps.min() >= 64 // count)
    assert np.mean(is_even) == pytest.approx(0.5, abs=0.1)
    assert rows.mean(axis=0) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_gaps_are_counted_and_filled_as_in_one_image(seed: int) -> None:
    batch = images(seed, 0.7)
    shares = row_gap_shares(batch[:, 0])
    expected = [row_gaps.row_gaps([image.numpy()]) for image in batch]
    assert shares.tolist() == pytest.approx(expected, abs=1e-4)
    is_filled = torch.tensor([True, False, True])
    filled = fill_rows(batch, is_filled)
    for image, before, is_changed in zip(filled, batch, is_filled, strict=True):
        after = row_gaps.fill_rows(before.numpy()) if is_changed else before.numpy()
        np.testing.assert_array_equal(image, after)


def test_an_image_without_points_has_no_gaps_to_fill() -> None:
    assert row_gap_shares(torch.zeros(1, 8, 16)).isnan().all()


@pytest.mark.parametrize("width", [0, 40, 64])
def test_a_window_as_wide_as_the_image_is_the_image(width: int) -> None:
    batch = images(0)
    truth = batch[:, 5].byte()
    columns = window_columns(truth, np.ones(3, bool), width, 1.0, batch_random())
    assert torch.equal(columns_of(batch, columns), batch)


def test_windows_begin_anywhere_or_contain_a_class_drawn_evenly() -> None:
    """Class 1 has one pixel, class 2 a column of them, class 3 is not scored."""
    truth = torch.zeros(600, 4, 32, dtype=torch.uint8)
    truth[:, 2, 31] = 1
    truth[:, :, 10] = 2
    truth[:, :, 20] = 3
    scored = np.array([False, True, True, False])
    columns = window_columns(truth, scored, 5, 1.0, batch_random())
    assert torch.equal(columns, (columns[:, :1] + torch.arange(5)) % 32)
    shows = [(columns == column).any(dim=1) for column in (31, 10)]
    assert (shows[0] ^ shows[1]).all()
    assert shows[0].float().mean().item() == pytest.approx(0.5, abs=0.1)
    places = (31 - columns[shows[0], 0]) % 32
    assert places.bincount(minlength=5).min() > 0.12 * len(places)
    anywhere = window_columns(truth, scored, 5, 0.0, batch_random())
    assert anywhere[:, 0].unique().tolist() == list(range(32))
    # Nothing is scored.
    nothing = window_columns(truth, ~scored & False, 5, 1.0, batch_random())
    assert nothing[:, 0].unique().tolist() == list(range(32))
