# SPDX-License-Identifier: MIT
"""Stage `train`: a labelled data set to a run folder with weights and log."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from salsanext_cli.commands.jobs.plans.training_plan import TrainingPlan
from salsanext_cli.commands.stages.new_training import AUTO, NewTraining, workers_here
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.loop.run_options import cores, worker_count
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.training.cross_validated_training import CrossValidatedTraining
from salsanext_cli.training.cross_validation import Expectation
from salsanext_cli.training.distributed import group_of_environment, process_group
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.initial_network import inheriting
from salsanext_cli.training.int8_ranges import add_int8_ranges
from salsanext_cli.training.preconditions import require_batch
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import BEST, LAST, Row
from salsanext_cli.training.setup import Setup
from salsanext_cli.training.tensorboard_files import require_tensorboard

MAX_LOADERS = 8  # Largest default number of processes that prepare samples for a GPU


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainResult:
    """Result of a training."""

    best: Path  # Weights of the best validation
    last: Path  # Weights of the last epoch
    best_miou: float | None  # On points, after kNN; None without a validation split
    rows: Sequence[Row]  # The log, a row per epoch
    warnings: list[ScanWarning]  # Reasons to doubt scans
    expected: Expectation | None = None  # Estimate for new scans, after a cross-validation

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; the log is a file of its own."""
        data: dict[str, object] = {"stage": "train", "best_miou": self.best_miou}
        if self.expected is not None:
            data["expected"] = plain(self.expected)
        data["best"] = str(self.best)
        data["last"] = str(self.last)
        data["warnings"] = plain(self.warnings)
        return data


def train(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    device: str = "auto",
    samples: str = AUTO,
    jobs: int | None = None,
    weights: Path | None = None,
    overwrite: bool = False,
    also: Sequence[Path] = (),
    tensorboard: bool = False,
    progress: Callable[[StepReport], object] = lambda report: None,
) -> TrainResult:
    """Train a network, or resume an interrupted training in the same folder.

    A recipe with folds cross-validates scans without a validation split, then trains on all of
    them. Workers of torchrun share every batch.

    Parameters
    ----------
    dataset : Path
        Labelled data set.
    run : Path
        Folder for weights, log and checkpoint.
    recipe : Recipe
        Settings of the training.
    sensor : Sensor, optional
        Sensor of the images; by default that of the initial weights, else an HDL-64.
    space : LabelSpace, optional
        Classes; by default those of the data set.
    device : str
        Device, such as ``"cpu"`` or ``"cuda:0"``; by default a GPU if there is one.
    samples : str
        Where samples are made: ``"device"``, from scans in its memory, or ``"workers"``, processes
        that read scans for each batch. By default as before in this folder, else on a GPU.
    jobs : int, optional
        Number of processes that prepare samples, or of threads that read scans for the device; by
        default up to eight processes on a GPU, else one, and one thread per core.
    weights : Path, optional
        Initial weights, by default those of the recipe.
    overwrite : bool
        Whether to start again instead of resuming.
    also : sequence of Path
        Further data sets for a share of the samples.
    tensorboard : bool
        Whether to write event files for TensorBoard too, which must be installed.
    progress : callable
        Called with a `StepReport` after every step.

    Returns
    -------
    TrainResult
    """
    opening = _new_training(
        dataset,
        run,
        recipe=recipe,
        device=device,
        samples=samples,
        jobs=jobs,
        weights=weights,
        overwrite=overwrite,
        also=also,
        tensorboard=tensorboard,
    )
    with opening as new, ExitStack() as locks:
        return _trained(new.setup(locks, space, sensor, progress), new.start)


def plan_training(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    device: str = "auto",
    samples: str = AUTO,
    jobs: int | None = None,
    weights: Path | None = None,
    overwrite: bool = False,
    also: Sequence[Path] = (),
    tensorboard: bool = False,
) -> TrainingPlan:
    """Return what `train` would do with the same arguments; write nothing into `run`.

    Parameters
    ----------
    dataset, run, recipe, sensor, space, device, samples, jobs
        As for `train`.
    weights, overwrite, also, tensorboard
        As for `train`.

    Returns
    -------
    TrainingPlan

    Raises
    ------
    SalsanextError
        What the training would refuse before it reads all scans.
    """
    opening = _new_training(
        dataset,
        run,
        recipe=recipe,
        device=device,
        samples=samples,
        jobs=jobs,
        weights=weights,
        overwrite=overwrite,
        also=also,
        tensorboard=tensorboard,
    )
    with opening as new:
        return new.plan(space, sensor)


@contextmanager
def _new_training(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    device: str,
    samples: str,
    jobs: int | None,
    weights: Path | None,
    overwrite: bool,
    also: Sequence[Path],
    tensorboard: bool,
) -> Iterator[NewTraining]:
    """Join the workers of torchrun, and yield the training; arguments as of `train`."""
    require_batch(recipe.batch, group_of_environment())
    if tensorboard:
        require_tensorboard()
    with process_group(device) as (group, chosen):
        yield NewTraining(
            roots=(dataset, *also),
            run=run,
            recipe=recipe,
            weights=weights,
            overwrite=overwrite,
            samples=samples,
            jobs=_workers(jobs, chosen.type),
            readers=max(1, cores() // workers_here()) if jobs is None else worker_count(jobs),
            group=group,
            device=chosen,
            tensorboard=tensorboard,
        )


def _trained(setup: Setup, start: Path | None) -> TrainResult:
    """Cross-validate scans without a validation split, and train on all scans.

    `start`: initial weights, whose error model the new ones inherit unless they get their own.
    """
    run = setup.run
    data = setup.data
    has_validation = bool(data.validation.files)
    expected = None
    if not has_validation:
        cross_validated = CrossValidatedTraining(setup)
        expected = cross_validated.expectation()
        setup = cross_validated.setup_of_all_scans(expected)
    if start and not expected:
        setup = replace(setup, card=inheriting(setup.card, start))
    state = setup.training(data.sources[0].files, data.validation).fit()
    setup.group.on_main(partial(add_int8_ranges, run, data.sources[0], str(setup.device)))
    return TrainResult(
        best=run / BEST,
        last=run / LAST,
        best_miou=state.best if has_validation else None,
        rows=state.rows,
        warnings=data.counts.warnings,
        expected=expected,
    )


def _workers(jobs: int | None, kind: str) -> int:
    """Return the number of processes that prepare samples; by default one on a CPU."""
    default = 1 if kind == "cpu" else max(1, min(MAX_LOADERS, cores() // workers_here()))
    return default if jobs is None else worker_count(jobs)
