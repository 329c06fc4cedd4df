# SPDX-License-Identifier: MIT
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from scans import SMALL, write_sequence

from salsanext_cli.classes import label_space
from salsanext_cli.errors import FormatError, LabelError, TrainingError
from salsanext_cli.formats.kitti import read_bin, read_labels, write_labels
from salsanext_cli.formats.layout import ScanFile, find_scans
from salsanext_cli.geometry.projection import project
from salsanext_cli.training.counting import count_classes, require_labels
from salsanext_cli.training.dataset import (
    Samples,
    batches,
    choose_columns,
    pixel_truth,
    read_labelled,
)
from salsanext_cli.training.plan import NOTHING, Plan
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.team import Team

SPACE = label_space()
RARE = np.isin(SPACE.names, ["bicycle", "person", "pole"])
PLAIN = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[ScanFile]:
    folder = tmp_path_factory.mktemp("data") / "sequences" / "00"
    return find_scans(write_sequence(folder, [f"{i:06d}" for i in range(5)]))


def samples(files: list[ScanFile], recipe: Recipe) -> Samples:
    return Samples(files, SPACE, SMALL, recipe, RARE)


def test_truth_is_that_of_each_pixels_nearest_point(files: list[ScanFile]) -> None:
    scan, labels = read_labelled(files[0], SPACE, SMALL)
    image = project(scan, SMALL)
    truth = pixel_truth(image, labels)
    for row, column in np.ndindex(truth.shape):
        point = image.point_of_pixel[row, column]
        assert truth[row, column] == (labels[point] if point >= 0 else 0)
    assert 0 in image.point_of_pixel  # the first point counts too
    assert (image.point_of_pixel < 0).any()


def test_truth_of_an_empty_scan_is_unlabelled(tmp_path: Path) -> None:
    (file,) = find_scans(write_sequence(tmp_path / "00", count=0))
    image, truth, _ = samples([file], Recipe())[0, 0]
    assert not truth.any()
    assert not image.any()


def test_a_sample_is_the_normalised_scan_and_its_truth(files: list[ScanFile]) -> None:
    image, truth, index = samples(files, PLAIN)[7, 2]
    scan = read_bin(files[2].path)
    raw = read_labels(files[2].label_path)
    projected = project(scan, SMALL)
    nearest = projected.point_of_pixel[3, 5]
    expected = (scan.points[nearest, 0] - SMALL.means[1]) / SMALL.stds[1]
    assert image.shape == (5, SMALL.height, SMALL.width)
    assert image.dtype == np.float32
    assert image[1, 3, 5] == pytest.approx(expected, rel=1e-5)
    assert truth.dtype == np.uint8
    assert truth[3, 5] == SPACE.learning_map[int(raw[nearest])]
    assert index == 2


def test_samples_differ_by_position_and_scan_and_repeat_by_both(files: list[ScanFile]) -> None:
    all_changes = Recipe(rotate=1.0, drop=1.0, crop_width=32)
    drawn = samples(files, all_changes)
    first, again = drawn[3, 1][0], drawn[3, 1][0]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, drawn[4, 1][0])
    assert not np.array_equal(first, drawn[3, 2][0])
    assert not np.array_equal(first, samples(files, all_changes.with_changes(seed=2))[3, 1][0])


@pytest.mark.parametrize("width", [0, 100, 200])
def test_no_crop_takes_every_column_in_order(width: int) -> None:
    columns = choose_columns(
        np.zeros((4, 100), np.uint8), SPACE.scored, width, 1.0, np.random.default_rng(0)
    )
    np.testing.assert_array_equal(columns, np.arange(100))


def test_windows_start_anywhere_and_go_round_the_circle() -> None:
    random = np.random.default_rng(0)
    truth = np.ones((2, 64), np.uint8)
    starts = set()
    for _ in range(1000):
        columns = choose_columns(truth, SPACE.scored, 24, 0.0, random)
        np.testing.assert_array_equal(columns, (columns[0] + np.arange(24)) % 64)
        starts.add(int(columns[0]))
    assert starts == set(range(64))


def test_windows_on_a_class_hold_rare_ones_as_often_as_common_ones() -> None:
    truth = np.full((4, 512), 9, np.uint8)
    truth[2, 100] = 6  # one pixel of person
    truth[:, 300] = 0  # unlabelled, never aimed at
    random = np.random.default_rng(0)
    holds = [
        6 in truth[:, choose_columns(truth, SPACE.scored, 32, 1.0, random)] for _ in range(1000)
    ]
    assert np.mean(holds) == pytest.approx(0.5 + 0.5 * 32 / 512, abs=0.05)


def test_windows_on_a_class_where_none_is() -> None:
    truth = np.zeros((4, 64), np.uint8)
    assert len(choose_columns(truth, SPACE.scored, 16, 1.0, np.random.default_rng(0))) == 16


def test_every_scan_is_drawn_once_before_any_is_drawn_again() -> None:
    plan = Plan(10, Recipe(epochs=3, batch=4))
    drawn = [index for batch in plan.batches() for _, index in batch]
    assert len(drawn) == 30
    for time in range(3):
        assert sorted(drawn[10 * time : 10 * time + 10]) == list(range(10))
    assert drawn[:10] != drawn[10:20]


def test_the_last_incomplete_batch_is_kept() -> None:
    plan = Plan(10, Recipe(epochs=2, batch=4))
    assert [len(batch) for batch in plan.batches()] == [4, 4, 2, 4, 4, 2]
    assert plan.steps == 6


@pytest.mark.parametrize("size", [3, 7, 25])
def test_epochs_of_another_size_than_the_data(size: int) -> None:
    plan = Plan(10, Recipe(epochs=4, batch=4, samples_per_epoch=size))
    draws = [draw for batch in plan.batches() for draw in batch]
    assert [position for position, _ in draws] == list(range(4 * size))
    counts = Counter(index for _, index in draws)
    assert max(counts.values()) - min(counts[i] for i in range(10)) <= 1
    assert len(list(plan.batches())) == plan.steps


@pytest.mark.parametrize("first", range(7))
def test_what_is_drawn_from_a_step_on_does_not_depend_on_where_one_begins(first: int) -> None:
    plan = Plan(5, Recipe(epochs=3, batch=3, samples_per_epoch=7))
    assert list(plan.batches(first)) == list(plan.batches())[first:]


@pytest.mark.parametrize("size", [1, 2, 3, 4])
@pytest.mark.parametrize("accumulate", [1, 3])
def test_workers_together_draw_what_one_alone_draws(size: int, accumulate: int) -> None:
    """Four batches of 5, 5, 5 and 1; the number of parts is the same for all workers."""
    plan = Plan(8, Recipe(epochs=2, batch=5, samples_per_epoch=8, accumulate=accumulate))
    shares = [list(plan.batches(1, Team(rank, size))) for rank in range(size)]
    whole = list(plan.batches(1))
    assert len(whole) == 3
    for batch, *parts in zip(whole, *shares, strict=True):
        drawn = [draw for share in parts for draw in share if draw != NOTHING]
        assert sorted(drawn) == sorted(batch)
        lengths = [len(share) for share in parts]
        assert len({min(accumulate, length) for length in lengths}) == 1
        assert min(lengths) >= 1
        assert max(lengths) == -(-len(batch) // size)
        assert NOTHING not in parts[0]


def test_an_epoch_of_all_workers_is_a_permutation_of_all_scans() -> None:
    plan = Plan(11, Recipe(epochs=1, batch=4))
    shares = [plan.batches(0, Team(rank, 2)) for rank in range(2)]
    indices = [index for share in shares for batch in share for _, index in batch]
    assert sorted(indices) == list(range(11))


@pytest.mark.parametrize("width", [0, 32, 10_000])
def test_nothing_has_the_size_of_a_sample_and_no_label(files: list[ScanFile], width: int) -> None:
    drawn = samples(files, Recipe(crop_width=width))
    (image, truth, _), (empty, none, index) = drawn[0, 0], drawn[NOTHING]
    assert (empty.shape, empty.dtype) == (image.shape, image.dtype)
    assert (none.shape, none.dtype) == (truth.shape, truth.dtype)
    assert not empty.any()
    assert not none.any()
    assert index == -1


def test_batches_do_not_depend_on_the_number_of_workers(files: list[ScanFile]) -> None:
    recipe = Recipe(epochs=1, batch=2, crop_width=32)
    plan = Plan(len(files), recipe)
    alone, helped = (list(batches(samples(files, recipe), plan, 0, n)) for n in (0, 1))
    assert len(alone) == len(helped) == 3
    for one, other in zip(alone, helped, strict=True):
        for a, b in zip(one, other, strict=True):
            assert torch.equal(a, b)
    # Seeds that are equal in all workers would show up as equal samples here.
    assert not torch.equal(helped[0][0], helped[1][0])


def test_counting_counts_every_point(files: list[ScanFile]) -> None:
    expected = np.zeros(SPACE.class_count, np.int64)
    for file in files:
        for raw in read_labels(file.label_path):
            expected[SPACE.learning_map[int(raw)]] += 1
    for jobs in (1, 2):
        np.testing.assert_array_equal(count_classes(files, SPACE, SMALL, jobs), expected)


def test_missing_labels_are_named(tmp_path: Path) -> None:
    files = find_scans(write_sequence(tmp_path / "00", ["a", "b", "c"]))
    require_labels(files)
    files[1].label_path.unlink()
    with pytest.raises(LabelError, match=r"b\.label · no such file · expected"):
        require_labels(files)
    files[2].label_path.unlink()
    with pytest.raises(LabelError, match=r"b\.label · no such file, nor for 1 other"):
        require_labels(files)


@pytest.mark.parametrize("labels", [np.full(9, 40), np.full(1500, 77), np.full(1500, 0)])
def test_labels_that_cannot_be_trained_on(labels: np.ndarray, tmp_path: Path) -> None:
    """Too few, of an unknown id, none of a class that counts."""
    files = find_scans(write_sequence(tmp_path / "00"))
    write_labels(files[0].label_path, labels.astype(np.uint32))
    with pytest.raises((LabelError, TrainingError), match=r"labels"):
        count_classes(files, SPACE, SMALL)


def test_a_truncated_scan_is_named(tmp_path: Path) -> None:
    (file,) = find_scans(write_sequence(tmp_path / "00"))
    file.path.write_bytes(file.path.read_bytes()[:-3])
    with pytest.raises(FormatError, match=r"000000\.bin"):
        count_classes([file], SPACE, SMALL)
