# SPDX-License-Identifier: MIT
"""`salsanext train`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli import console, options, run_options
from salsanext_cli.cli.progress import progress

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import Progress
    from salsanext_cli.training.fit import Report


def train(
    dataset: options.LabelledDataSet = Path(),
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder for the weights, the log and the curves.")
    ] = Path("run"),
    *,
    recipe: Annotated[
        str,
        options.network_option(
            help="paper, paper-v1, modern, street, heteroscedastic, quick, or a .toml file."
        ),
    ] = "paper",
    changes: Annotated[
        list[str] | None,
        options.network_option(
            "--set",
            metavar="KEY=VALUE",
            help="Value instead of the recipe's; may be given several times.",
        ),
    ] = None,
    epochs: Annotated[
        int | None, options.network_option(help="Number of epochs instead of the recipe's.")
    ] = None,
    weights: Annotated[
        Path | None,
        options.network_option(help="Weights to start from.", show_default="random weights"),
    ] = None,
    label_space: options.LabelSpaceOption = None,
    sensor: Annotated[
        str | None, options.sensor_option(show_default="the sensor of --weights, else hdl64")
    ] = None,
    device: options.Device = "auto",
    jobs: run_options.Jobs = 1,
    overwrite: run_options.Overwrite = False,
    output: run_options.Output,
) -> None:
    """Train a network. After an interruption, the same command continues the training.

    Example: salsanext train streets/ runs/street --recipe street
    """
    from salsanext_cli.stages.train import train as stage
    from salsanext_cli.training.distributed import group_of_environment
    from salsanext_cli.training.overrides import read_overrides
    from salsanext_cli.training.recipe import recipe as find_recipe

    if not group_of_environment().is_main:
        output = run_options.Output(quiet=True)
    with progress("train", output.quiet, unit="steps") as bar:
        plan = find_recipe(recipe).with_changes(**read_overrides(changes or ()))
        done = stage(
            dataset,
            run,
            recipe=plan if epochs is None else plan.with_changes(epochs=epochs),
            sensor=options.sensor(sensor),
            space=options.label_space(label_space),
            device=device,
            jobs=jobs,
            weights=weights,
            overwrite=overwrite,
            progress=lambda report: _show(report, bar, output),
        )
    best = f"{100 * done.best_miou:.1f} %"
    paths = {"best": str(done.best), "last": str(done.last)}
    output.result({"stage": "train", "best_miou": done.best_miou, **paths})
    output.say(f"train: best validation mIoU {best} → {done.best}")


def _show(report: "Report", bar: "Progress | None", output: console.Output) -> None:
    """Move the bar at every step; print a line at the end of an epoch."""
    if bar is not None:
        bar(report.step, report.steps)
    if report.row is not None:
        miou = report.row.get("miou")
        scored = "" if miou is None else f", validation mIoU {100 * miou:.1f} %"
        output.say(f"epoch {report.epoch}/{report.epochs}: loss {report.row['loss']:.3f}{scored}")
