# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from salsanext_cli.training.data import noise
from salsanext_cli.training.data.noise import (
    CONTINUED,
    EDGE_RATIO,
    HOLE_SHARES,
    MAX_RUN,
    MOST_HOLES,
    MOST_JITTER_M,
    RANGE_EDGES_M,
    hole_cells,
    jitter,
    make_holes,
)


def image(seed: int, shape: tuple[int, int] = (6, 40), empty: float = 0.5) -> np.ndarray:
    """Return ranges with steps, some of them empty."""
    random = np.random.default_rng(seed)
    ranges = random.choice([3.0, 3.2, 7.0, 15.0, 30.0, 60.0, 90.0], shape).astype(np.float32)
    return np.where(random.random(shape) < empty, np.float32(0), ranges)


def cell_by_walking(row: list[float], column: int) -> int:
    """Return the cell of a pixel: walk from it both ways round the circle."""
    found = []
    for way in (-1, 1):
        for step in range(1, MAX_RUN + 1):
            if there := row[(column + way * step) % len(row)]:
                found.append((there, step))
                break
    if len(found) < 2 or found[0][1] + found[1][1] - 1 > MAX_RUN:
        return -1
    near, far = sorted(value for value, _ in found)
    kind = int(far / near > EDGE_RATIO)
    return kind * HOLE_SHARES.shape[1] + sum(near >= edge for edge in RANGE_EDGES_M)


@pytest.mark.parametrize("seed", range(5))
def test_cells_are_those_of_the_next_measured_pixels(seed: int) -> None:
    ranges = image(seed)
    wanted = [[cell_by_walking(row, k) for k in range(len(row))] for row in ranges.tolist()]
    np.testing.assert_array_equal(hole_cells(ranges), wanted)


def test_pixels_are_lost_whole_and_as_often_as_their_cell_says() -> None:
    channels = np.stack([image(1, (64, 512), 0.1), np.full((64, 512), 7, np.float32)])
    before, cells = channels.copy(), hole_cells(channels[0])
    for seed in range(12):
        factor = np.random.default_rng(seed).uniform(0, MOST_HOLES)
        found = make_holes(channels, np.random.default_rng(seed))
        lost = found[1] == 0
        np.testing.assert_array_equal(found, np.where(lost, 0, before))
        assert found.dtype == np.float32
        assert not lost[cells < 0].any()
        for cell, share in enumerate(HOLE_SHARES.ravel()):
            of_cell, wanted = lost[cells == cell], factor * share
            # Runs make the mean vary as that of fewer pixels would.
            spread = 5 * np.sqrt(2.5 * wanted / len(of_cell))
            assert of_cell.mean() == pytest.approx(wanted, abs=spread)
    np.testing.assert_array_equal(channels, before)


def test_holes_of_one_surface_come_in_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next pixel is lost as this one is, or else by a chance of its own."""
    monkeypatch.setattr(noise, "MOST_HOLES", 0.0)
    assert make_holes(np.full((1, 8, 64), 7, np.float32), np.random.default_rng(0)).all()
    monkeypatch.setattr(noise, "MOST_HOLES", 3.0)
    lost = make_holes(np.full((1, 400, 512), 7, np.float32), np.random.default_rng(5))[0] == 0
    going_on = lost[:, 1:][lost[:, :-1]].mean()
    assert going_on == pytest.approx(CONTINUED + (1 - CONTINUED) * lost.mean(), abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_jitter_is_normal_noise_on_measured_points(seed: int) -> None:
    points = np.full((20_000, 3), 9, np.float32)
    points[:3] = [[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0]]
    moved = jitter(points, np.random.default_rng(seed))
    assert moved.dtype == np.float32
    assert not moved[0].any()
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    offset = moved[3:].astype(float) - 9
    wanted = np.random.default_rng(seed).uniform(0, MOST_JITTER_M)
    np.testing.assert_allclose(offset.std(axis=0), wanted, rtol=0.05)
    np.testing.assert_allclose(offset.mean(axis=0), 0, atol=0.05 * MOST_JITTER_M)
    assert abs(np.corrcoef(offset.T) - np.eye(3)).max() < 0.05
    assert (np.abs(offset) < 2 * wanted).mean() == pytest.approx(0.954, abs=0.01)
