# SPDX-License-Identifier: MIT
"""Batches of a device, beside the samples of workers: equal without chance, alike with it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import pytest
import torch
from host_waits import META, WaitsRefused
from scan_stores import maker_of, round_to_half, with_statistics
from scans import SMALL, real_scans, write_bin, write_sequence

from salsanext_cli import Scan, label_space
from salsanext_cli import sensor as named_sensor
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.on_device import batch_maker
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

SPACE = label_space()
RARE = np.isin(SPACE.names, ["bicycle", "person", "pole"])
PLAIN = Recipe(rotate=0.0, shift=0.0, flip=0.0, drop=0.0)
COMPARED = 1000  # Samples of each path
MOST_DEVIATIONS = 5.0  # Largest difference of two means in standard errors


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[ScanFile]:
    """Return five scans of unlike numbers of points, whose values float16 has."""
    folder = tmp_path_factory.mktemp("data") / "sequences" / "00"
    files = []
    for number, count in enumerate((1500, 1200, 1500, 1801, 1400)):
        files = find_scans(write_sequence(folder, [str(number)], count=count, seed=number))
    round_to_half(files)
    return files


def samples(files: list[ScanFile], recipe: Recipe, sensor: Sensor = SMALL) -> Samples:
    return Samples(
        sources=[Source(files=files, space=SPACE, sensor=sensor)],
        sensor=sensor,
        recipe=recipe,
        rare=RARE,
    )


def test_without_chance_images_are_those_of_workers(files: list[ScanFile]) -> None:
    drawn = samples(files, PLAIN)
    keys = [(7, 2), (8, 0), (9, 3)]
    images, truth = maker_of(drawn).make(keys)
    assert images.dtype == torch.float32
    assert truth.dtype == torch.uint8
    for number, key in enumerate(keys):
        image, targets = drawn[key]
        np.testing.assert_allclose(images[number], image, atol=1e-6)
        np.testing.assert_array_equal(truth[number], targets)


def test_the_vehicle_is_not_shown_and_gaps_are_filled_where_workers_fill_them(files) -> None:
    """Two sequences with sensors of their own: another field of view, a box, many gaps."""
    half = {file: replace(file, sequence=str(number % 2)) for number, file in enumerate(files)}
    sensor = replace(SMALL, row_gaps=0.1)
    fitted = {
        "0": replace(SMALL, fov_up=8.0, row_gaps=0.3, out_of_view="drop"),
        "1": replace(SMALL, fov_down=-30.0, row_gaps=0.1, ego_box=(1, -9, -2, 9, 3, 1)),
    }
    source = Source(files=[*half.values()], space=SPACE, sensor=sensor, fitted=fitted)
    drawn = replace(samples(files, PLAIN, sensor), sources=[source])
    keys = [(0, index) for index in range(5)]
    images, truth = maker_of(drawn).make(keys)
    for number, key in enumerate(keys):
        image, targets = drawn[key]
        np.testing.assert_allclose(images[number], image, atol=1e-6)
        np.testing.assert_array_equal(truth[number], targets)


def test_images_of_a_batch_have_one_of_the_widths(files: list[ScanFile]) -> None:
    drawn = samples(files, PLAIN.with_changes(widths="32,64", crop_width=32))
    maker = maker_of(drawn)
    narrow = 0
    for position in range(30):
        images, truth = maker.make([(position, 1), (position + 1, 2)])
        assert images.shape == (2, 5, SMALL.height, 32)
        assert truth.shape == (2, SMALL.height, 32)
        at_width = replace(drawn, recipe=PLAIN.with_changes(widths="32", crop_width=32))
        narrow += np.allclose(images[0], at_width[0, 1][0], atol=1e-6)
    assert 5 <= narrow <= 25


def test_a_batch_depends_on_its_position_its_scans_the_seed_and_the_worker(files) -> None:
    recipe = Recipe(rotate=1.0, drop=1.0, mix=0.5, paste=0.5, jitter=1.0, crop_width=32)
    maker = maker_of(samples(files, recipe))
    keys = [(3, 1), (4, 2)]
    first = maker.make(keys)
    again = maker.make(keys)
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[1], again[1])
    others = (
        maker.make([(5, 1), (6, 2)]),
        maker.make([(3, 0), (4, 2)]),
        replace(maker, rank=1).make(keys),
        maker_of(samples(files, recipe.with_changes(seed=2))).make(keys),
    )
    assert not any(torch.equal(first[0], images) for images, _ in others)


def test_a_sensor_without_intensity_has_the_mean_of_training(files: list[ScanFile]) -> None:
    sensor = with_statistics(SMALL, files)
    drawn = samples(files, PLAIN.with_changes(no_intensity=1.0), sensor)
    images, _ = maker_of(drawn).make([(0, 1), (1, 4)])
    for number, index in enumerate((1, 4)):
        np.testing.assert_allclose(images[number], drawn[0, index][0], atol=1e-5)


def test_scans_without_a_measurement_make_empty_images(tmp_path) -> None:
    folder = write_sequence(tmp_path / "sequences" / "00", ["0", "1"], count=3)
    nothing = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0]], np.float32)
    for stem in ("0", "1"):
        write_bin(folder / "velodyne" / f"{stem}.bin", Scan(nothing, np.ones(3, np.float32)))
    recipe = Recipe(
        rotate=1.0,
        drop=1.0,
        mix=1.0,
        paste=1.0,
        holes=1.0,
        fewer_beams=1.0,
        intensity=1.0,
        jitter=1.0,
        crop_width=16,
        crop_on_class=1.0,
    )
    sensor = replace(SMALL, row_gaps=0.1)
    images, truth = maker_of(samples(find_scans(folder), recipe, sensor)).make([(0, 0), (1, 1)])
    assert images.shape == (2, 5, SMALL.height, 16)
    assert not images.any()
    assert not truth.any()


@pytest.mark.real
def test_pixels_of_real_scans_have_the_classes_of_workers(real_data: Path) -> None:
    """But for points that 16 bits move over the border of a pixel."""
    (path, *_) = (path for path in real_scans(real_data) if "semantickitti" in path.parts)
    scans = [file for file in find_scans(path.parents[3]) if file.label_path.exists()]
    drawn = samples(scans[:2], PLAIN, named_sensor("hdl64"))
    _, truth = maker_of(drawn).make([(0, 0), (1, 1)])
    for number in range(2):
        image, targets = drawn[0, number]
        is_full = image.any(axis=0)
        assert (truth[number].numpy() == targets)[is_full].mean() > 0.975


class MetaRandom(BatchRandom):
    """Random numbers of the device `meta`, whose tensors have shapes but no values."""

    @classmethod
    def seeded(cls, seed: Sequence[int], device: torch.device) -> Self:
        return cls(host=np.random.default_rng(seed), points=torch.Generator())

    @property
    def device(self) -> torch.device:
        return META

    def uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, device=META)

    def normal(self, *shape: int) -> torch.Tensor:
        return torch.randn(shape, device=META)


def test_the_host_waits_for_nothing_in_a_batch(files, monkeypatch) -> None:
    """A GPU makes a batch while its host goes on; `meta` refuses both, without a GPU."""
    monkeypatch.setattr(batch_maker, "BatchRandom", MetaRandom)
    chances = ("mix", "paste", "intensity", "mount", "view", "fewer_beams", "jitter", "holes")
    recipe = Recipe(
        crop_width=32, crop_on_class=0.5, no_intensity=0.5, **dict.fromkeys(chances, 0.5)
    )
    sensor = with_statistics(SMALL, files)
    source = Source(
        files=files,
        space=SPACE,
        sensor=sensor,
        fitted={"00": replace(sensor, ego_box=(1, -9, -2, 9, 3, 1), min_range=1.0)},
    )
    maker = maker_of(replace(samples(files, recipe, sensor), sources=[source]))
    for scans in (maker.store.whole, maker.store.pasted):
        for key, scan in scans.items():
            scans[key] = StoredScan(values=scan.values.to(META), targets=scan.targets.to(META))
    for position in range(4):
        keys = [(position, 0), (position + 1, 3)]
        with WaitsRefused():
            images, truth = replace(maker, device=META).make(keys)
        assert images.device == truth.device == META
        assert images.shape == (2, 5, SMALL.height, 32)
        assert (truth.shape, truth.dtype) == ((2, SMALL.height, 32), torch.uint8)


# Equal distributions


def traits(image: np.ndarray, truth: np.ndarray) -> list[float]:
    """Return numbers that describe a sample: means, deviations and shares of its pixels."""
    is_full = image.any(axis=0)
    pixels = image[:, is_full] if is_full.any() else np.zeros((5, 1))
    targets = truth[is_full]
    rows = np.flatnonzero(is_full.any(axis=1))
    return [
        is_full.mean(),
        len(rows),
        *pixels.mean(axis=1),
        *pixels.std(axis=1),
        np.abs(pixels).max(),
        RARE[targets].mean() if len(targets) else 0.0,
        np.abs(np.diff(image[0], axis=1)).mean(),
        np.abs(np.diff(image[0], axis=0)).mean(),
        is_full[:, : is_full.shape[1] // 2].mean(),
        is_full[: is_full.shape[0] // 2].mean(),
    ]


CHANGES: dict[str, dict[str, object]] = {
    key: {key: 1.0}
    for key in (
        *("rotate", "shift", "flip", "drop", "mix", "paste", "intensity", "no_intensity"),
        *("mount", "view", "fewer_beams", "jitter", "holes"),
    )
}
CHANGES["window"] = {"crop_width": 32}
CHANGES["window on a class"] = {"crop_width": 32, "crop_on_class": 1.0}
CHANGES["all by chance"] = {
    **dict.fromkeys(("rotate", "shift", "flip", "drop", "mix", "paste", "intensity"), 0.5),
    **dict.fromkeys(("mount", "view", "fewer_beams", "jitter", "holes", "no_intensity"), 0.3),
    "crop_width": 48,
    "crop_on_class": 0.5,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_samples_have_the_moments_of_those_of_workers(files: list[ScanFile], name: str) -> None:
    recipe = PLAIN.with_changes(**CHANGES[name])
    drawn = samples(files, recipe, with_statistics(SMALL, files))
    keys = [(position, position % len(files)) for position in range(COMPARED)]
    one = np.array([traits(*drawn[key]) for key in keys])
    maker = maker_of(drawn)
    other = []
    for start in range(0, COMPARED, 25):
        images, truth = maker.make(keys[start : start + 25])
        other += [traits(*sample) for sample in zip(images.numpy(), truth.numpy(), strict=True)]
    compare_moments(one, np.array(other))


def compare_moments(one: np.ndarray, other: np.ndarray) -> None:
    """Compare means and standard deviations of the traits (N, K) of two sets of samples."""
    error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / len(one))
    scale = 1e-4 * (1 + np.abs(one.mean(axis=0)))
    difference = np.abs(one.mean(axis=0) - other.mean(axis=0))
    np.testing.assert_array_less(difference, MOST_DEVIATIONS * error + scale)
    # The error of a deviation follows from the fourth moment.
    centred = one - one.mean(axis=0)
    variance = np.square(centred).mean(axis=0)
    spread = np.square(np.square(centred) - variance).mean(axis=0)
    error = np.sqrt(2 * spread / len(one))
    difference = np.abs(variance - other.var(axis=0))
    np.testing.assert_array_less(difference, MOST_DEVIATIONS * error + scale)


@pytest.mark.slow
def test_samples_of_another_distribution_have_other_moments(files: list[ScanFile]) -> None:
    """The comparison of moments can fail."""
    half = samples(files, PLAIN.with_changes(drop=0.5))
    always = samples(files, PLAIN.with_changes(drop=1.0))
    keys = [(position, 0) for position in range(200)]
    one, other = (np.array([traits(*drawn[key]) for key in keys]) for drawn in (half, always))
    with pytest.raises(AssertionError):
        compare_moments(one, other)
