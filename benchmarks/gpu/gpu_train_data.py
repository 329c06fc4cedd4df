# SPDX-License-Identifier: MIT
"""Scans of a training on a GPU: scenes that are simulated meanwhile, and packed real scans."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import torch

from benchmarks.weights.default_weights import LABEL_SPACES, compose_circles, split_pandaset
from benchmarks.weights.pack import unpack
from benchmarks.weights.scene_pool import KINDS, ScenePool
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.class_counts import class_counts, class_weights, rare_classes
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.sources import Source, fitted_source
from salsanext_cli.training.data.targets import class_sets
from salsanext_cli.training.recipe import Recipe

PLANNED = 1 << 20  # Scans of each kind of sensor, more than any run simulates
COUNTED_SCANS = 32  # Scans of each kind whose points of each class are counted


@dataclass(frozen=True, kw_only=True)
class RealScans:
    """Real scans to train on, and those that are held out, by name."""

    training: list[Source]
    held_out: dict[str, Source]


def packed_scans(pack: Path | None, folder: Path, sensor: Sensor, jobs: int) -> RealScans:
    """Return the real scans of a pack, which are unpacked into a folder; none without a pack."""
    roots = {root.name: root for root in unpack(pack, folder)} if pack else {}
    return real_scans(roots, folder, sensor, jobs)


def real_scans(roots: Mapping[str, Path], folder: Path, sensor: Sensor, jobs: int) -> RealScans:
    """Return the real scans of data sets.

    The scans of PandaSet's two sensors are one source. The same scans are held out as for the
    default weights.

    Parameters
    ----------
    roots : mapping of Path
        Data sets by name.
    folder : Path
        Folder for scans that are composed of others.
    sensor : Sensor
        Sensor that the network is trained for.
    jobs : int
        Processes that read scans.

    Returns
    -------
    RealScans
    """
    if unknown := sorted(roots.keys() - LABEL_SPACES.keys()):
        problem = f"are {', '.join(unknown)}"
        raise TrainingError("real scans", problem, f"some of {', '.join(LABEL_SPACES)}")
    training: list[Source] = []
    held_out: dict[str, Source] = {}
    if "pandaset" in roots:
        scans = {name: find_scans(root) for name, root in roots.items() if name != "aachen"}
        files, late = split_pandaset(scans)
        all_files = sorted(chain(files, *late.values()))
        whole = fitted_source(source_of(all_files, "pandaset", sensor), jobs)
        training.append(replace(whole, files=files))
        held_out = {name: replace(whole, files=late_files) for name, late_files in late.items()}
    elif "pandargt" in roots:
        raise TrainingError("real scans", "are pandargt without pandaset", "both")
    if "aachen" in roots:
        compose_circles(roots["aachen"], folder / "circles")
        circles = source_of(find_scans(folder / "circles"), "aachen", sensor)
        training.append(fitted_source(circles, jobs))
    return RealScans(training=training, held_out=held_out)


def source_of(files: Sequence[ScanFile], name: str, sensor: Sensor) -> Source:
    """Return files as a source with the label space of a packed data set."""
    return Source(files=files, space=label_space(LABEL_SPACES[name]), sensor=sensor)


@dataclass(frozen=True, kw_only=True)
class TrainingData:
    """Samples of a training on scenes that are made meanwhile, and what its scans determine."""

    samples: Samples
    weights: torch.Tensor  # (C,) float32: of the classes in the loss
    digests: frozenset[str]  # Of the real scans


def training_data(
    path: Path,
    pool: ScenePool,
    real: Sequence[Source],
    validation: Source,
    recipe: Recipe,
    card: WeightsCard,
    jobs: int,
) -> TrainingData:
    """Count the points of each class in the first scenes and all real scans, into a file.

    Parameters
    ----------
    path : Path
        File of the counts.
    pool : ScenePool
        Simulated scenes.
    real : sequence of Source
        Real scans to train on.
    validation : Source
        Simulated scans to validate on.
    recipe : Recipe
        Recipe of the training.
    card : WeightsCard
        Card of its weights.
    jobs : int
        Processes that count.

    Returns
    -------
    TrainingData
    """
    scenes = [pool.source(kind) for kind in KINDS]
    first = [replace(source, files=source.files[:COUNTED_SCANS]) for source in scenes]
    counted = [*first, *real]
    counts = class_counts(path, counted, validation, validation.files, jobs, recipe.also)
    planned = [pool.source(kind, PLANNED) for kind in KINDS]
    sources = [*planned, *real]
    scored = card.space.scored
    samples = Samples(
        sources=sources,
        sensor=card.sensor,
        recipe=recipe,
        rare=rare_classes(counts.points, scored),
        sets=class_sets(source.space for source in sources),
    )
    return TrainingData(
        samples=samples,
        weights=class_weights(counts.points, scored, recipe.class_weight),
        digests=frozenset(counts.digests[file] for source in real for file in source.files),
    )
