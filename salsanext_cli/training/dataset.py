# SPDX-License-Identifier: MIT
"""Samples of labelled scans, and their order, the same whatever the number of worker processes.

Everything drawn for a sample comes from a generator of its own, seeded by the recipe's seed and
the sample's position in the whole training.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.errors import SalsanextError
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.geometry.gather import pixels_from_points
from salsanext_cli.geometry.normalise import normalise
from salsanext_cli.geometry.projection import project
from salsanext_cli.records import Float
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.training.augment import (
    PASTED_COPIES,
    Checkerboard,
    LabelledScan,
    augment,
    choose_columns,
    mix,
    paste,
    select,
)
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.recipe import Recipe

ORDER, SAMPLE = 0, 1
"""Purposes of generators, a part of their seeds, so that no two are alike."""

SampleKey = tuple[int, int]
"""Position of a sample in the whole training, index of its scan."""

Sample = tuple[Float, TrainIds, int]
"""Normalised image (5, H, W), truth (H, W), index of the scan."""

Batch = tuple[Tensor, Tensor, Tensor]
"""Normalised images (B, 5, H, W), truth (B, H, W) uint8, indices of the scans (B,) int64."""


def read_labelled(file: ScanFile, space: LabelSpace, sensor: Sensor) -> LabelledScan:
    """Read a scan and the train ids of its points, (N,) uint8.

    Raises
    ------
    FormatError
        If a file cannot be read.
    LabelError
        If the numbers differ or a label id is unknown.
    """
    scan = read_scan(file.path, sensor)
    raw = read_labels(file.label_path, len(scan))
    return scan, space.to_train(raw, source=file.label_path)


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """Batches of the whole training, each a list of sample keys.

    Every scan is drawn once before any is drawn again, and every batch is whole: the last one of an
    epoch goes on with the next round of scans. A batch of one or two would upset the statistics of
    batch norm just before they are validated.

    Attributes
    ----------
    scan_count : int
    recipe : Recipe
    """

    scan_count: int
    recipe: Recipe

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches of an epoch, which hold all its samples."""
        return -(-(self.recipe.samples_per_epoch or self.scan_count) // self.recipe.batch)

    @property
    def steps(self) -> int:
        """Number of batches of the whole training."""
        return self.steps_per_epoch * self.recipe.epochs

    def crop_width(self, position: int) -> int:
        """Return the columns of the window of a sample, 0 for the full circle."""
        epoch = position // (self.steps_per_epoch * self.recipe.batch)
        last = epoch >= self.recipe.epochs - self.recipe.whole_epochs
        return 0 if self.recipe.whole_epochs and last else self.recipe.crop_width

    def batches(
        self, first_step: int = 0, group: ProcessGroup = SINGLE_PROCESS
    ) -> Iterator[list[SampleKey]]:
        """Yield a worker's share of each batch, from a step of the whole training to its end.

        The shares of all workers together are the batch that one alone would have.
        """
        keys = self._keys(first_step * self.recipe.batch)
        for _ in range(first_step, self.steps):
            yield list(islice(keys, self.recipe.batch))[group.rank :: group.size]

    def _keys(self, position: int) -> Iterator[SampleKey]:
        """Yield keys without end, from a position of the whole training."""
        while True:
            time, place = divmod(position, self.scan_count)
            random = np.random.default_rng((self.recipe.seed, ORDER, time))
            for index in random.permutation(self.scan_count)[place:]:
                yield position, int(index)
                position += 1


@dataclass(frozen=True, slots=True, eq=False)
class Samples(Dataset[Sample]):
    """Augmented, mixed, projected, normalised and cropped scans, by sample key.

    Attributes
    ----------
    files : sequence of ScanFile
        Labelled scans.
    space : LabelSpace
        Of their labels.
    sensor : Sensor
        Projection and normalisation of the images.
    recipe : Recipe
        Settings of augmentation, mixing and cropping.
    rare : (C,) bool
        Classes that are pasted.
    """

    files: Sequence[ScanFile]
    space: LabelSpace
    sensor: Sensor
    recipe: Recipe
    rare: npt.NDArray[np.bool_]

    @property
    def plan(self) -> SamplingPlan:
        """Order of the samples in the whole training."""
        return SamplingPlan(len(self.files), self.recipe)

    def __getitem__(self, key: SampleKey) -> Sample:
        """Return the sample at a position of the training, of the scan with an index."""
        position, index = key
        width = self.plan.crop_width(position)
        random = np.random.default_rng((self.recipe.seed, SAMPLE, position))
        scan, labels = self._mixed(index, random)
        image = project(scan, self.sensor)
        truth = pixels_from_points(labels, image.point_of_pixel)
        on_class = self.recipe.crop_on_class
        columns = choose_columns(truth, self.space.scored, width, on_class, random)
        return normalise(image.channels[:, :, columns], self.sensor), truth[:, columns], index

    def _mixed(self, index: int, random: np.random.Generator) -> LabelledScan:
        """Return an augmented scan, mixed with others as often as the recipe says."""
        recipe = self.recipe
        labelled = augment(self._read(index), recipe, random)
        # Without mixing nothing more is drawn, so that the samples are those of older versions.
        if recipe.mix and random.random() < recipe.mix:
            partner = augment(self._partner(index, random), recipe, random)
            labelled = mix(labelled, partner, Checkerboard.drawn(self.sensor, random))
        if recipe.paste and random.random() < recipe.paste:
            partner = self._partner(index, random)
            rare = augment(select(partner, self.rare[partner[1]]), recipe, random)
            labelled = paste(labelled, rare, random.uniform(-np.pi, np.pi, PASTED_COPIES))
        return labelled

    def _partner(self, index: int, random: np.random.Generator) -> LabelledScan:
        """Return another scan than the one of an index; the same if there is no other."""
        away = 1 + random.integers(max(1, len(self.files) - 1))
        return self._read(int((index + away) % len(self.files)))

    def _read(self, index: int) -> LabelledScan:
        return read_labelled(self.files[index], self.space, self.sensor)


def batches(
    samples: Samples,
    first_step: int,
    workers: int = 0,
    *,
    pinned: bool = False,
    group: ProcessGroup = SINGLE_PROCESS,
) -> Iterator[Batch]:
    """Yield the batches from a step to the end of the training.

    Parameters
    ----------
    samples : Samples
    first_step : int
        Step to begin with.
    workers : int
        Processes that prepare samples beside this one; 0 for none.
    pinned : bool
        Whether to put batches into memory that a GPU copies from quickly.
    group : ProcessGroup
        Workers that share each batch.
    """
    loader: DataLoader[Any] = DataLoader(
        _ErrorsAsValues(samples),
        collate_fn=_collate,
        batch_sampler=samples.plan.batches(first_step, group),
        num_workers=workers,
        # A fork would inherit locks that the threads of torch and numba may hold.
        multiprocessing_context="spawn" if workers else None,
        pin_memory=pinned,
    )
    for batch in loader:
        if isinstance(batch, SalsanextError):
            raise batch
        yield batch


@dataclass(frozen=True, slots=True, eq=False)
class _ErrorsAsValues(Dataset[Sample | SalsanextError]):
    """Samples whose errors are returned, since a loader would not raise them as they are."""

    samples: Samples

    def __getitem__(self, key: SampleKey) -> Sample | SalsanextError:
        try:
            return self.samples[key]
        except SalsanextError as error:
            return error


def _collate(items: list[Sample | SalsanextError]) -> Any:
    """Make a batch of samples, or return the first error among them."""
    errors = (item for item in items if isinstance(item, SalsanextError))
    return next(errors, None) or default_collate(items)
