# SPDX-License-Identifier: MIT
"""Samples of labelled scans and their order, independent of the number of worker processes.

Recipe and position in the training seed the generator of each sample.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import count, islice
from typing import Any

import numba
import numpy as np
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from salsanext_cli.core import wording
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.intensity import NO_INTENSITY, bright_intensity, match_intensity
from salsanext_cli.core.geometry.network_input import normalise
from salsanext_cli.core.geometry.projection import pixels_from_points, project
from salsanext_cli.core.geometry.row_gaps import row_gaps, with_filled_gaps
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.sensors.sensor import ORIGIN, UP, Sensor
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data import augment, other_sensors
from salsanext_cli.training.data.augment import AnnotatedScan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.data.targets import ClassSets, target_mask
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.recipe import Recipe

ORDER = 0  # Part of the seed of orders
SAMPLE = 1  # Part of the seed of samples; `learner.DROPOUT` is another

SampleKey = tuple[int, int]  # Position of a sample in the whole training, index of its scan
Sample = tuple[Float, TrainIds]  # Normalised image (5, H, W), targets (H, W)
Batch = tuple[Tensor, Tensor]  # Normalised images (B, 5, H, W) float32, targets (B, H, W) uint8


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingPlan:
    """Batches of the whole training, each a list of sample keys.

    Every scan of a data set is drawn once before any is drawn again. For batch norm every batch is
    whole: the last one of an epoch begins the next round. Further data sets share `recipe.also` of
    the samples evenly.
    """

    scan_counts: Sequence[int]
    recipe: Recipe

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches of an epoch."""
        return -(-(self.recipe.samples_per_epoch or sum(self.scan_counts)) // self.recipe.batch)

    @property
    def steps(self) -> int:
        """Number of batches of the whole training."""
        return self.steps_per_epoch * self.recipe.epochs

    def batches(
        self, first_step: int = 0, group: ProcessGroup = SINGLE_PROCESS
    ) -> Iterator[list[SampleKey]]:
        """Yield a worker's share of each batch, from a step of the whole training to its end."""
        keys = self._keys(first_step * self.recipe.batch)
        for _ in range(first_step, self.steps):
            yield list(islice(keys, self.recipe.batch))[group.rank :: group.size]

    def _keys(self, start: int) -> Iterator[SampleKey]:
        """Yield keys endlessly from a position of the whole training."""
        # Each data set is in one round at a time.
        order = lru_cache(len(self.scan_counts))(self._order)
        for position in count(start):
            source, draw = self._draw(position)
            number, index = divmod(draw, self.scan_counts[source])
            yield position, order(source, number)[index]

    def _draw(self, position: int) -> tuple[int, int]:
        """Return the data set of a position, and the number of draws from it before."""
        further_count = len(self.scan_counts) - 1
        share = self.recipe.also if further_count else 0.0
        further = int(position * share)
        if int((position + 1) * share) == further:
            return 0, position - further
        return 1 + further % further_count, further // further_count

    def _order(self, source: int, number: int) -> list[int]:
        """Return the shuffled indices of a data set's scans in a round, counted from 0."""
        seed = (self.recipe.seed, ORDER, number, *((source,) if source else ()))
        order = np.random.default_rng(seed).permutation(self.scan_counts[source])
        return [sum(self.scan_counts[:source]) + int(i) for i in order]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Samples(Dataset[Sample]):
    """Augmented, mixed, projected, normalised and cropped scans, by sample key.

    `sensor` has the normalisation, intensity and gaps of training; `rare` (C,) marks the classes
    whose points are pasted.
    """

    sources: Sequence[Source]
    sensor: Sensor
    recipe: Recipe
    rare: Mask
    sets: ClassSets = ()

    @property
    def plan(self) -> SamplingPlan:
        """Order of the samples in the whole training."""
        return SamplingPlan(
            scan_counts=[len(source.files) for source in self.sources], recipe=self.recipe
        )

    def scan_at(self, index: int) -> tuple[Source, ScanFile]:
        """Return the data set and file of a scan; indices continue over all data sets."""
        for source in self.sources:
            if index < len(source.files):
                return source, source.files[index]
            index -= len(source.files)
        raise IndexError(index)

    def __getitems__(self, keys: Sequence[SampleKey]) -> list[Sample] | SalsanextError:
        """Return samples, or the error of one, since a loader would raise it in another form."""
        try:
            return [self[key] for key in keys]
        except SalsanextError as error:
            return error

    def __getitem__(self, key: SampleKey) -> Sample:
        """Return the sample at a position of the training, of the scan with an index."""
        position, index = key
        recipe = self.recipe
        random = np.random.default_rng((recipe.seed, SAMPLE, position))
        annotated = self._mixed(index, random)
        source, file = self.scan_at(index)
        view = replace(source.sensor_of(file), up=UP, origin=ORIGIN, registered=False)
        if recipe.image_widths:
            view = view.resized(width=int(random.choice(recipe.image_widths)))
        if _drawn(recipe.view, random):
            view = other_sensors.other_view(view, random)
        image = project(annotated.scan, view)
        truth = pixels_from_points(annotated.labels, image.point_of_pixel)
        # Pixels and rows are removed, and gaps filled, in both alike.
        both = np.concatenate([image.channels, truth[None].astype(np.float32)])
        if _drawn(recipe.holes, random):
            both = other_sensors.make_holes(both, random)
        if _drawn(recipe.fewer_beams, random):
            both = other_sensors.fewer_beams(both, random)
            view = replace(view, row_gaps=row_gaps([both]))
        both = with_filled_gaps(both, view, self.sensor)
        channels = both[:-1]
        truth = both[-1].astype(np.uint8)
        if _drawn(recipe.no_intensity, random):
            channels = match_intensity(channels, NO_INTENSITY, self.sensor.intensity_quantiles)
        scored = target_mask(self.sources[0].space.scored, self.sets, np.any)
        columns = augment.choose_columns(
            truth, scored, recipe.crop_width, recipe.crop_on_class, random
        )
        return normalise(channels[:, :, columns], self.sensor), truth[:, columns]

    def _mixed(self, index: int, random: np.random.Generator) -> AnnotatedScan:
        """Return an augmented scan, mixed with others by chance."""
        recipe = self.recipe
        annotated = self._augmented(self._read(index, random), random)
        if _drawn(recipe.mix, random):
            partner = self._augmented(self._partner(index, random), random)
            board = augment.Checkerboard.random(self.sensor, random)
            annotated = augment.mix(annotated, partner, board)
        if _drawn(recipe.paste, random):
            partner = self._partner(index, random)
            is_rare = target_mask(self.rare, self.sets, np.all)[partner.labels]
            rare = self._augmented(augment.select(partner, is_rare), random)
            angles = random.uniform(-np.pi, np.pi, augment.PASTED_COPIES)
            annotated = augment.paste(annotated, rare, angles)
        return annotated

    def _augmented(self, annotated: AnnotatedScan, random: np.random.Generator) -> AnnotatedScan:
        augmented = augment.augment(annotated, self.recipe, random)
        scan = augmented.scan
        if _drawn(self.recipe.mount, random):
            scan = replace(scan, points=other_sensors.mount_otherwise(scan.points, random))
        if _drawn(self.recipe.jitter, random):
            scan = replace(scan, points=other_sensors.jitter(scan.points, random))
        return AnnotatedScan(scan, augmented.labels)

    def _partner(self, index: int, random: np.random.Generator) -> AnnotatedScan:
        """Return another scan than one, from further data sets as often as samples are."""
        counts = self.plan.scan_counts
        source = 0
        if len(counts) > 1 and random.random() < self.recipe.also:
            source = int(random.integers(1, len(counts)))
        start = sum(counts[:source])
        count = counts[source]
        if start <= index < start + count:
            away = 1 + random.integers(max(1, count - 1))
            return self._read(int(start + (index - start + away) % count), random)
        return self._read(start + int(random.integers(count)), random)

    def _read(self, index: int, random: np.random.Generator) -> AnnotatedScan:
        source, file = self.scan_at(index)
        annotated = source.read(file, self.sets)
        if not _drawn(self.recipe.intensity, random):
            return annotated
        brightest = bright_intensity(self.sensor)
        scan = other_sensors.change_intensity(annotated.scan, brightest, random)
        return AnnotatedScan(scan, annotated.labels)


def _drawn(chance: float, random: np.random.Generator) -> bool:
    """Decide by chance; a chance of 0 draws nothing, as in older versions."""
    return chance > 0 and random.random() < chance


def batches(
    samples: Samples,
    first_step: int,
    workers: int = 0,
    *,
    pinned: bool = False,
    group: ProcessGroup = SINGLE_PROCESS,
) -> Iterator[Batch]:
    """Yield the batches from a step to the end of the training, prepared by workers if any."""
    loader: DataLoader[Any] = DataLoader(
        samples,
        collate_fn=_collate,
        batch_sampler=samples.plan.batches(first_step, group),
        num_workers=workers,
        # A fork would inherit locks held by threads of torch and numba.
        multiprocessing_context="spawn" if workers else None,
        worker_init_fn=partial(_begin_worker, wording.used()),
        pin_memory=pinned,
    )
    for batch in loader:
        if isinstance(batch, SalsanextError):
            raise batch
        yield batch


def _begin_worker(spelling: wording.Spelling, _: int) -> None:
    """Use one thread in a new worker, and the spelling of the process that started it."""
    wording.use(spelling)
    # Torch has one thread in each worker already.
    numba.config.NUMBA_NUM_THREADS = 1  # type: ignore[attr-defined]


def _collate(items: list[Sample] | SalsanextError) -> Any:
    return items if isinstance(items, SalsanextError) else default_collate(items)
