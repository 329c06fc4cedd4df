# SPDX-License-Identifier: MIT
"""`salsanext train`."""

import shlex
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.commands.line import arguments, console
from salsanext_cli.commands.line.completion import completer
from salsanext_cli.commands.line.console import progress
from salsanext_cli.commands.line.interruption import require_uninterrupted, stating
from salsanext_cli.commands.line.option_fields import argument, network_option, option_group
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.runs.network_settings import weights_file
from salsanext_cli.runs.results.query import named_label_space

if TYPE_CHECKING:
    from salsanext_cli.commands.stages.train import TrainResult
    from salsanext_cli.runs.loop.run import Progress
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

    def plan(self) -> "Recipe":
        """Return the recipe with its changes."""
        from salsanext_cli.commands.line.recipe_changes import read_overrides
        from salsanext_cli.training.recipe import recipe

        plan = recipe(self.recipe).with_changes(**read_overrides(self.changes or ()))
        return plan if self.epochs is None else plan.with_changes(epochs=self.epochs)


def train(
    dataset: Path = arguments.labelled_argument(default=Path(), show_default="the current folder"),
    run: Path = argument("Folder to write weights and log to.", default=Path("run"), metavar="RUN"),
    *,
    start: Start,
    label_space: str | None = arguments.LABEL_SPACE,
    device: str = arguments.DEVICE,
    jobs: int | None = arguments.jobs_option(
        default=None, show_default="1; on a GPU one per core, up to 8"
    ),
    overwrite: bool = arguments.OVERWRITE,
    output: console.Output,
) -> None:
    """Train a network. After an interruption, the same command continues the training.

    Example: salsanext train scenes/ runs/street --recipe street
    """
    from salsanext_cli.commands.stages.train import train as stage
    from salsanext_cli.training.distributed import group_of_environment
    from salsanext_cli.training.run_folder import resumption

    if not group_of_environment().is_main:
        output = console.Output(quiet=True)
    resumed = partial(resumption, run)
    with progress("train", output.quiet, unit="steps") as bar, stating(resumed):
        done = stage(
            dataset,
            run,
            recipe=start.plan(),
            sensor=arguments.sensor(start.sensor),
            space=named_label_space(label_space),
            device=device,
            jobs=jobs,
            weights=start.weights and weights_file(start.weights),
            overwrite=overwrite,
            also=start.also or (),
            progress=lambda report: _show(report, bar, output),
        )
    result: dict[str, Any] = {"stage": "train", "best_miou": done.best_miou}
    result |= {"expected": asdict(done.expected)} if done.expected else {}
    result |= {"best": str(done.best), "last": str(done.last), "warnings": done.warnings}
    output.result(result)
    output.print(f"train: {_score_text(done)} → {done.best}")
    output.print(f"next: salsanext predict SCANS OUT --weights {shlex.quote(str(done.best))}")


def _score_text(done: "TrainResult") -> str:
    if (e := done.expected) is None:
        miou = done.best_miou
        return "not scored" if miou is None else f"best validation mIoU {percentage(miou)}"
    texts = ", ".join(
        f"{name} {100 * mean:.1f}{'' if spread is None else f' ± {100 * spread:.1f}'} %"
        f"{'' if before is None else f' (before {percentage(before)})'}"
        for name, mean, spread, before in (
            ("mIoU", e.miou, e.miou_spread, e.miou_before),
            ("accuracy", e.accuracy, e.accuracy_spread, e.accuracy_before),
        )
    )
    scans = "new scans of this drive" if e.one_drive else "new scans"
    sizes = f"{counted(e.folds, 'fold')}, {counted(e.epochs, 'epoch')}"
    return f"estimated on {scans}: {texts} ({sizes})"


def _show(report: "StepReport", bar: "Progress | None", output: console.Output) -> None:
    """Move the bar at every step; print a line at the end of an epoch."""
    require_uninterrupted()
    if bar is not None:
        bar(report.step, report.steps)
    if report.row is not None:
        scores = (("mIoU", report.row.get("miou")), ("accuracy", report.row.get("accuracy")))
        texts = [f", {name} {percentage(value)}" for name, value in scores if value is not None]
        fold = f"fold {report.fold}, " if report.fold else ""
        epoch = f"{fold}epoch {report.epoch}/{report.epochs}"
        output.print(f"{epoch}: loss {report.row['loss']:.3f}{''.join(texts)}")
