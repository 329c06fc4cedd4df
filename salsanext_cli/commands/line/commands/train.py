# SPDX-License-Identifier: MIT
"""`salsanext train`."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.completion import completer
from salsanext_cli.commands.line.options.option_fields import (
    argument,
    network_option,
    option_group,
    running_option,
)
from salsanext_cli.commands.line.output import console
from salsanext_cli.commands.line.output.interruption import on_interruption, require_uninterrupted
from salsanext_cli.commands.line.output.printed_plan import print_training_plan
from salsanext_cli.commands.line.output.progress import progress_display
from salsanext_cli.commands.line.values.typed_values import typed_sensor
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.runs.network_settings import weights_file
from salsanext_cli.runs.results.query import named_label_space

if TYPE_CHECKING:
    from salsanext_cli.commands.stages.train import TrainResult
    from salsanext_cli.runs.loop.run import Progress
    from salsanext_cli.training.cross_validation import Expectation
    from salsanext_cli.training.fit import StepReport
    from salsanext_cli.training.recipe import Recipe


def _recipes() -> Iterable[str]:
    """Return the names of the built-in recipes."""
    from salsanext_cli.training.recipe import presets

    return presets()


@option_group
class Start:
    """Recipe, weights and sensor that a training starts from."""

    recipe: str = network_option(
        "Recipe of the training.",
        default="paper",
        metavar="paper|modern|street|finetune|quick|FILE",
        autocompletion=completer(_recipes),
    )
    changes: list[str] | None = network_option(
        "Change a key of the recipe; may be given several times.", "--set", metavar="KEY=VALUE"
    )
    epochs: int | None = network_option("Number of epochs.", show_default="as in the recipe")
    weights: Path | None = network_option(
        "Weights to start from; `default` names the weights of the package.",
        metavar="FILE|default",
        show_default="random; with finetune the weights of the package",
    )
    sensor: str | None = network_option(
        "Sensor to train for.",
        metavar="NAME|FILE",
        show_default="the sensor of --weights, else hdl64",
    )
    also: list[Path] | None = network_option(
        "Further data set with the same classes, for a share of the samples (--set also=0.5); may "
        "be given several times.",
        metavar="DATASET",
    )

    def changed_recipe(self) -> "Recipe":
        """Return the recipe with its changes."""
        from salsanext_cli.commands.line.values.recipe_changes import read_overrides
        from salsanext_cli.training.recipe import recipe

        changes = read_overrides(self.changes or ())
        changed = recipe(self.recipe).with_changes(**changes)
        return changed if self.epochs is None else changed.with_changes(epochs=self.epochs)


def train(
    dataset: Path = declarations.labelled_argument(
        default=Path(), show_default="the current folder"
    ),
    run: Path = argument("Folder to write weights and log to.", default=Path("run"), metavar="RUN"),
    *,
    start: Start,
    label_space: str | None = declarations.LABEL_SPACE,
    device: str = declarations.DEVICE,
    samples: Literal["auto", "device", "workers"] = running_option(
        "Where samples are made: on the device, from scans in its memory, or by processes.",
        default="auto",
        show_default="as before in RUN, else the device if it is a GPU",
    ),
    jobs: int | None = declarations.jobs_option(
        default=None,
        show_default="1, on a GPU one per core up to 8; one per core to read for the device",
    ),
    tensorboard: bool = running_option(
        "Also write event files for TensorBoard to RUN/events; needs the package tensorboard.",
        default=False,
    ),
    overwrite: bool = declarations.OVERWRITE,
    dry_run: bool = declarations.DRY_RUN,
    output: console.Output,
) -> None:
    """Train a network. After an interruption, the same command continues the training.

    Example: salsanext train scenes/ runs/street --recipe street
    """
    from salsanext_cli.commands.stages.train import plan_training
    from salsanext_cli.commands.stages.train import train as stage
    from salsanext_cli.training.distributed import group_of_environment
    from salsanext_cli.training.run_folder import resumption

    # Of the processes that torchrun starts, only the main one prints.
    if not group_of_environment().is_main:
        output = console.Output(quiet=True)
        console.log_to_stderr(quiet=True)
    recipe = start.changed_recipe()
    sensor = typed_sensor(start.sensor)
    space = named_label_space(label_space)
    weights = weights_file(start.weights) if start.weights else None
    if dry_run:
        plan = plan_training(
            dataset,
            run,
            recipe=recipe,
            sensor=sensor,
            space=space,
            device=device,
            samples=samples,
            jobs=jobs,
            weights=weights,
            overwrite=overwrite,
            also=start.also or (),
            tensorboard=tensorboard,
        )
        print_training_plan(plan, run, output)
        return
    with (
        progress_display("train", output.quiet, unit="steps") as bar,
        on_interruption(lambda: resumption(run)),
    ):
        result = stage(
            dataset,
            run,
            recipe=recipe,
            sensor=sensor,
            space=space,
            device=device,
            samples=samples,
            jobs=jobs,
            weights=weights,
            overwrite=overwrite,
            also=start.also or (),
            tensorboard=tensorboard,
            progress=lambda report: _show_step(report, bar, output),
        )
    output.result(result.to_dict())
    output.print(f"train: {_score_text(result)} → {result.best}")
    output.print(f"next: salsanext predict SCANS OUT --weights {shlex.quote(str(result.best))}")


def _score_text(result: "TrainResult") -> str:
    """Return the scores of a training: the estimate for new scans, else those of validation."""
    if result.expected is not None:
        return _expectation_text(result.expected)
    if result.best_miou is None:
        return "not scored"
    return f"best validation mIoU {percentage(result.best_miou)}"


def _expectation_text(expected: "Expectation") -> str:
    """Return the estimate of a cross-validation in words."""
    scans = "new scans of this drive" if expected.one_drive else "new scans"
    miou = _estimate_text("mIoU", expected.miou, expected.miou_spread, expected.miou_before)
    accuracy = _estimate_text(
        "accuracy", expected.accuracy, expected.accuracy_spread, expected.accuracy_before
    )
    sizes = f"{counted(expected.folds, 'fold')}, {counted(expected.epochs, 'epoch')}"
    return f"estimated on {scans}: {miou}, {accuracy} ({sizes})"


def _estimate_text(name: str, mean: float, spread: float | None, before: float | None) -> str:
    """Return a score, 0…1, with its spread and its value before the training where known."""
    text = f"{name} {100 * mean:.1f}"
    if spread is not None:
        text += f" ± {100 * spread:.1f}"
    text += " %"
    if before is not None:
        text += f" (before {percentage(before)})"
    return text


def _show_step(report: "StepReport", bar: "Progress | None", output: console.Output) -> None:
    """Move the bar at every step; print a line at the end of an epoch."""
    require_uninterrupted()
    if bar is not None:
        bar(report.step, report.steps)
    if report.row is None:
        return
    fold_text = f"fold {report.fold}, " if report.fold else ""
    text = f"{fold_text}epoch {report.epoch}/{report.epochs}: loss {report.row['loss']:.3f}"
    for name, key in (("mIoU", "miou"), ("accuracy", "accuracy")):
        score = report.row.get(key)
        if score is not None:
            text += f", {name} {percentage(score)}"
    output.print(text)
