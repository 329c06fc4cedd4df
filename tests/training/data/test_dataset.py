# SPDX-License-Identifier: MIT
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from scans import SMALL, write_sequence
from torch.utils.data import get_worker_info

from salsanext_cli import label_space, project
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.compiled import thread_count
from salsanext_cli.core.geometry.network_input import normalise
from salsanext_cli.core.network.card import scan_digest
from salsanext_cli.core.wording import argument, spelled
from salsanext_cli.io.formats.kitti import read_bin
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.class_counts import class_shares, count_classes, rare_classes
from salsanext_cli.training.data.dataset import Sample, SampleKey, Samples, SamplingPlan, batches
from salsanext_cli.training.data.sources import Source, read_labelled
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.recipe import Recipe

SPACE = label_space()
RARE = np.isin(SPACE.names, ["bicycle", "person", "pole"])
PLAIN = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[ScanFile]:
    folder = tmp_path_factory.mktemp("data") / "sequences" / "00"
    return find_scans(write_sequence(folder, [f"{i:06d}" for i in range(5)]))


def samples(files: list[ScanFile], recipe: Recipe) -> Samples:
    return Samples(
        sources=[Source(files=files, space=SPACE, sensor=SMALL)],
        sensor=SMALL,
        recipe=recipe,
        rare=RARE,
    )


def test_a_sample_is_the_normalised_scan_and_its_truth(files: list[ScanFile]) -> None:
    image, truth = samples(files, PLAIN)[7, 2]
    scan = read_bin(files[2].path)
    raw = read_labels(files[2].label_path)
    projected = project(scan, SMALL)
    row, column = np.argwhere(projected.point_of_pixel >= 0)[100]
    nearest = projected.point_of_pixel[row, column]
    expected = (scan.points[nearest, 0] - SMALL.means[1]) / SMALL.stds[1]
    assert image.shape == (5, SMALL.height, SMALL.width)
    assert image.dtype == np.float32
    assert image[1, row, column] == pytest.approx(expected, rel=1e-5)
    assert truth.dtype == np.uint8
    assert truth[row, column] == SPACE.learning_map[int(raw[nearest])]


def test_samples_are_windows_of_images_of_the_drawn_widths(files: list[ScanFile]) -> None:
    recipe = PLAIN.with_changes(widths="32,64,64", crop_width=32)
    scan = read_bin(files[2].path)
    images = {w: normalise(project(scan, SMALL.resized(width=w)).channels, SMALL) for w in (32, 64)}
    turned = [(w, np.roll(images[w], -start, 2)) for w in images for start in range(w)]
    drawn = Counter[int]()
    for position in range(60):
        window, truth = samples(files, recipe)[position, 2]
        assert window.shape[1:] == truth.shape == (SMALL.height, 32)
        drawn.update({w for w, image in turned if np.array_equal(image[:, :, :32], window)})
    assert drawn.total() == 60
    assert 10 <= drawn[32] <= 30


def test_samples_differ_by_position_and_scan_and_repeat_by_both(files: list[ScanFile]) -> None:
    all_changes = Recipe(rotate=1.0, drop=1.0, crop_width=32)
    drawn = samples(files, all_changes)
    first, again = drawn[3, 1][0], drawn[3, 1][0]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, drawn[4, 1][0])
    assert not np.array_equal(first, drawn[3, 2][0])
    assert not np.array_equal(first, samples(files, all_changes.with_changes(seed=2))[3, 1][0])


@pytest.mark.parametrize("size", [0, 3, 7, 25])
def test_every_scan_is_drawn_once_before_any_is_drawn_again(size: int) -> None:
    """In epochs of any size, whose batches are all whole."""
    plan = SamplingPlan(scan_counts=[10], recipe=Recipe(epochs=4, batch=4, samples_per_epoch=size))
    assert [len(batch) for batch in plan.batches()] == plan.steps * [4]
    draws = [draw for batch in plan.batches() for draw in batch]
    assert [position for position, _ in draws] == list(range(4 * plan.steps))
    assert (size or 10) <= 4 * plan.steps_per_epoch < (size or 10) + 4
    rounds = [[index for _, index in draws[i : i + 10]] for i in range(0, len(draws), 10)]
    assert all(sorted(each) == list(range(10)) for each in rounds[:-1])
    assert len(set(rounds[-1])) == len(rounds[-1])
    assert rounds[0] != rounds[1][: len(rounds[0])]


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_workers_together_draw_what_one_alone_draws(size: int) -> None:
    plan = SamplingPlan(scan_counts=[8], recipe=Recipe(epochs=2, batch=5))
    shares = [list(plan.batches(1, ProcessGroup(rank=rank, size=size))) for rank in range(size)]
    whole = list(plan.batches(1))
    assert len(whole) == 3
    for batch, *parts in zip(whole, *shares, strict=True):
        assert sorted(key for share in parts for key in share) == sorted(batch)
        lengths = [len(share) for share in parts]
        assert max(lengths) - min(lengths) <= 1


class OneThread(Samples):
    """Samples that a worker may prepare on one thread only."""

    def __getitem__(self, key: SampleKey) -> Sample:
        if get_worker_info():
            assert (thread_count(), torch.get_num_threads()) == (1, 1)
            assert argument("jobs") == "--jobs"
        return Samples.__getitem__(self, key)


def test_batches_do_not_depend_on_the_number_of_workers(files: list[ScanFile]) -> None:
    recipe = Recipe(epochs=2, batch=2, crop_width=32, mix=0.5, paste=0.5)
    sources = [Source(files=files, space=SPACE, sensor=SMALL)]
    one_thread = OneThread(sources=sources, sensor=SMALL, recipe=recipe, rare=RARE)
    with spelled(CommandLine()):
        alone, helped = (list(batches(one_thread, 0, n)) for n in (0, 1))
    assert len(alone) == len(helped) == 6
    assert [images.shape[3] for images, *_ in alone] == 6 * [32]
    for one, other in zip(alone, helped, strict=True):
        for a, b in zip(one, other, strict=True):
            assert torch.equal(a, b)
    # Seeds that are equal in all workers would show up as equal samples here.
    assert not torch.equal(helped[0][0], helped[1][0])


def pixels(files: list[ScanFile], recipe: Recipe, index: int) -> list[tuple[np.ndarray, int]]:
    """Return x, y, z and the class of every filled pixel of a sample."""
    image, truth = samples(files, recipe)[3, index]
    filled = image.any(axis=0)
    shown = image[1:4, filled].T * SMALL.stds[1:4] + SMALL.means[1:4]
    return list(zip(shown, truth[filled], strict=True))


def test_pixels_of_a_mixed_sample_are_points_of_two_scans(files: list[ScanFile]) -> None:
    read = [read_labelled(file, SPACE, SMALL) for file in files]
    sources = Counter[int]()
    for point, label in pixels(files, PLAIN.with_changes(mix=1.0), 1)[::5]:
        off = [np.abs(annotated.scan.points - point).max(axis=1) for annotated in read]
        source = int(np.argmin([each.min() for each in off]))
        assert off[source].min() < 1e-4
        assert label == read[source].labels[off[source].argmin()]
        sources[source] += 1
    assert len(sources) == 2
    assert 1 in sources
    assert min(sources.values()) > 0.2 * sources.total()


def test_pasted_pixels_are_turned_points_of_rare_classes(files: list[ScanFile]) -> None:
    read = [read_labelled(file, SPACE, SMALL) for file in files]
    points = read[1].scan.points
    rare = np.concatenate([annotated.scan.points[RARE[annotated.labels]] for annotated in read])
    pasted = 0
    for point, label in pixels(files, PLAIN.with_changes(paste=1.0), 1)[::3]:
        if np.abs(points - point).max(axis=1).min() > 1e-3:
            assert RARE[label]
            apart = np.hypot(*rare.T[:2]) - np.hypot(*point[:2])
            assert np.hypot(apart, rare[:, 2] - point[2]).min() < 1e-3
            pasted += 1
    assert pasted > 20


def test_rare_classes_have_less_than_a_hundredth_of_the_scored_points() -> None:
    counts = np.array([10_000, 9, 991, 10, 0])
    scored = np.array([False, True, True, True, True])
    shares = class_shares(counts, scored)
    np.testing.assert_allclose(shares, [0, 9 / 1010, 991 / 1010, 10 / 1010, 0])
    assert rare_classes(counts, scored).tolist() == [False, True, False, True, True]
    counts[3] = 11
    assert rare_classes(counts, scored).tolist() == [False, True, False, False, True]
    assert not rare_classes(np.zeros(5, int), ~scored)[1:].any()


def test_counting_counts_every_point(files: list[ScanFile]) -> None:
    expected = np.zeros(SPACE.class_count, np.int64)
    for file in files:
        for raw in read_labels(file.label_path):
            expected[SPACE.learning_map[int(raw)]] += 1
    for jobs in (1, 2):
        scans = count_classes(Source(files=files, space=SPACE, sensor=SMALL), jobs)
        assert [summary.file for summary in scans.summaries] == list(files)
        np.testing.assert_array_equal(scans.points.sum(axis=0), expected)
        own = np.bincount(SPACE.to_train(read_labels(files[1].label_path)), minlength=20)
        np.testing.assert_array_equal(scans.points[1], own)
        assert scans.digests == [scan_digest(read_bin(file.path)) for file in files]


def test_points_of_the_vehicle_are_neither_drawn_nor_counted(files: list[ScanFile]) -> None:
    low = (-7.0, -3.0, -9.0)
    high = (7.0, 3.0, 9.0)
    sensor = replace(SMALL, min_range=5.0, ego_box=low + high)
    source = Source(files=files, space=SPACE, sensor=sensor)
    for file, points in zip(files, count_classes(source).points, strict=True):
        xyz = read_bin(file.path).points
        is_near = np.linalg.norm(xyz, axis=1) < 5
        is_vehicle = is_near | ((xyz >= low) & (xyz <= high)).all(axis=1)
        assert 0 < is_near.sum() < is_vehicle.sum() < len(xyz)
        labels = SPACE.to_train(read_labels(file.label_path))[~is_vehicle]
        np.testing.assert_array_equal(points, np.bincount(labels, minlength=SPACE.class_count))
        np.testing.assert_array_equal(source.read(file, ()).labels, labels)
