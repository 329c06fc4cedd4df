# SPDX-License-Identifier: MIT
"""Stage `train`: a labelled data set to a run folder with weights, log and curve."""

import hashlib
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import UsageError
from salsanext_cli.inference.scan_fit import with_sensor
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.parallel.threads import worker_count
from salsanext_cli.report.scan_pictures import draw_sample
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.files.identity import fingerprint
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import evenly_spaced
from salsanext_cli.training.class_counts import (
    ClassCounts,
    class_counts,
    class_weights,
    rare_classes,
    require_labels,
)
from salsanext_cli.training.dataset import Samples
from salsanext_cli.training.distributed import ProcessGroup, group_of_environment, process_group
from salsanext_cli.training.fit import Report, Training
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.log import Row, tensorboard_in
from salsanext_cli.training.precision import common_precision
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    BEST,
    CLASS_COUNTS,
    EVENTS,
    LAST,
    begin,
    recorded_precision,
    require_free,
    trained_alone,
)
from salsanext_cli.training.sources import (
    Source,
    as_trained,
    further_source,
    labelled_split,
)
from salsanext_cli.training.targets import class_sets


@dataclass(frozen=True, slots=True)
class TrainResult:
    """Result of a training.

    Attributes
    ----------
    best, last : Path
        Weights files: of the best validation, and of the end.
    best_miou : float
        Validation mIoU on points, after kNN, of the best weights.
    rows : sequence of Row
        The log, a row per epoch.
    warnings : list of dict
        Reasons to doubt scans, as `RunSummary.warnings` lists them.
    """

    best: Path
    last: Path
    best_miou: float
    rows: Sequence[Row]
    warnings: list[dict[str, Any]]


def train(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    device: str = "auto",
    jobs: int = 1,
    weights: Path | None = None,
    overwrite: bool = False,
    strict: bool = False,
    also: Sequence[Path] = (),
    progress: Callable[[Report], object] = lambda report: None,
) -> TrainResult:
    """Train a network, or resume a training that was interrupted in the same folder.

    Started by torchrun, each worker learns from its share of every batch, and the first writes.

    Parameters
    ----------
    dataset : Path
        A data set root; its label space says which sequences are for training and validation.
    run : Path
        Gets ``best.safetensors``, ``last.safetensors``, ``log.csv``, ``curve.png``,
        ``recipe.toml``, a picture per epoch in ``samples`` and a checkpoint to resume from.
    recipe : Recipe
        How to train.
    sensor : Sensor, optional
        How to project; by default the sensor of `weights`, else the HDL-64.
    space : LabelSpace, optional
        Meaning of the labels and split of the sequences; by default what the data set says, else
        SemanticKITTI's.
    device : str
        As `choose_device` takes it; under torchrun each worker of a machine has its own GPU.
    jobs : int
        Processes that prepare samples; with 1 the training process does it itself.
    weights : Path, optional
        Weights to start from instead of random ones.
    overwrite : bool
        Whether to start anew where the folder holds a training.
    strict : bool
        Whether to refuse doubtful scans.
    also : sequence of Path
        Roots of further data sets of the same classes, whose training splits the recipe's share
        `also` of the samples is drawn from.
    progress : callable
        Called with a `Report` after every step.

    Raises
    ------
    NoInputError, LabelError, FormatError, TrainingError
        Before the first step, if the data cannot be trained on; `TrainingError` if the loss is
        not finite.
    OutputError
        If the folder cannot be written, holds another training or files that salsanext did not
        write.
    WeightsError
        If `weights` do not fit the label space.
    """
    workers = worker_count(jobs)
    if recipe.batch < (size := group_of_environment().size):
        expected = f"at least one sample for each of {size} workers"
        remedy = "start fewer workers or set batch higher"
        raise UsageError("recipe key batch", f"{recipe.batch}", expected, remedy)
    with process_group(device) as (group, place), ExitStack() as held:
        classes, training = group.on_main(lambda: labelled_split(dataset, space, "train"))
        _, validation = group.on_main(lambda: labelled_split(dataset, classes, "valid"))
        validated = evenly_spaced(validation, recipe.validation_scans)
        if recipe.precision == "auto":
            begun = None if overwrite else group.on_main(lambda: recorded_precision(run))
            recipe = replace(recipe, precision=begun or common_precision(place, group))
        module, architecture, own_sensor = initial_network(weights, classes, recipe)
        sensor = sensor or own_sensor
        _require_pixels(recipe, sensor, module, group)
        roots = ", ".join(path.resolve().name for path in (dataset, *also))
        description = f"Trained with `salsanext train` on {roots}."
        further = group.on_main(lambda: [further_source(path, classes, sensor) for path in also])
        given = [Source(files, classes, sensor) for files in (training, validation)] + further
        sets = class_sets(source.space for source in given)

        def prepare() -> tuple[list[Source], ClassCounts]:
            settings = _settings(recipe, given, weights)
            held.enter_context(trained_alone(run))
            require_free(run, settings, overwrite=overwrite)
            require_labels([file for source in given for file in source.files])
            first, scored, *others = as_trained(given, fit=recipe.sensors == "fitted", jobs=jobs)
            kept, sources = run / CLASS_COUNTS, [first, *others]
            counts = class_counts(kept, sources, scored, validated, jobs, recipe.also)
            if strict:
                counts.require_no_warnings(dataset)
            begin(run, settings, overwrite=overwrite)
            return [scored, *sources], counts

        (scored, *sources), counts = group.on_main(prepare)
        seen, of_class = sources[0].sensor, (counts.points, classes.scored)
        class_weight = class_weights(*of_class, recipe.class_weight)
        drawn = validated[0]
        state = Training(
            run=run,
            learner=Learner(module, recipe, class_weight, place, group, sets),
            samples=Samples(sources, seen, recipe, rare_classes(*of_class), sets),
            validation=replace(scored, files=validated),
            card=WeightsCard(architecture, classes, seen, recipe.to_dict(), {}, description),
            workers=workers if jobs != 1 else 0,
            draw=lambda file, network: draw_sample(
                file, drawn, with_sensor(network, scored.sensor_of(drawn))
            ),
            write_epoch=held.enter_context(tensorboard_in(run, EVENTS, wanted=group.is_main)),
            report=progress,
        ).fit()
    return TrainResult(run / BEST, run / LAST, state.best, state.rows, counts.warnings)


def _require_pixels(
    recipe: Recipe, sensor: Sensor, module: SegmentationNetwork, group: ProcessGroup
) -> None:
    """Refuse images whose coarsest level has one pixel: batch norm needs two to differ."""
    part = recipe.batch // group.size // min(recipe.accumulate, recipe.batch // group.size)
    size = (sensor.height, min(recipe.crop_width or sensor.width, sensor.width))
    coarsest = [-(-pixels // step) for pixels, step in zip(size, module.stride, strict=True)]
    if part * math.prod(coarsest) == 1:
        found = f"one pixel is left of one image of {size[0]}×{size[1]}"
        raise UsageError("recipe key crop_width", found, "two pixels for batch norm at least")


def _settings(recipe: Recipe, sources: Sequence[Source], weights: Path | None) -> dict[str, Any]:
    """Return all that decides the result of a training; see `train` for the order of sources."""
    first, validation, *further = sources
    settings: dict[str, Any] = {
        "recipe": recipe.to_dict(),
        "sensor": replace(first.sensor, intensity_quantiles=(), row_gaps=None).to_dict(),
        "label_space": first.space.to_dict(),
        "scans": _digest([*first.files, *validation.files]),
        "weights": fingerprint(weights) if weights else None,
    }
    if further:
        settings["also"] = [
            {"label_space": each.space.to_dict(), "scans": _digest(each.files)} for each in further
        ]
    return settings


def _digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names."""
    names = "\n".join(f"{scan.sequence}/{scan.stem}" for scan in scans)
    return f"{len(scans)}, {hashlib.sha256(names.encode()).hexdigest()[:16]}"
