# SPDX-License-Identifier: MIT
"""`salsanext train`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import Progress
    from salsanext_cli.training.fit import Report


@console.guarded
def train(
    dataset: options.LabelledDataSet = Path(),
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder for the weights.")] = Path(
        "run"
    ),
    recipe: Annotated[
        str,
        typer.Option(
            help="paper, paper-v1, modern, street, quick, or a .toml file.",
            rich_help_panel="Network",
        ),
    ] = "paper",
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Instead of the recipe's value; may be given several times.",
            rich_help_panel="Network",
        ),
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(help="Instead of the recipe's.", rich_help_panel="Network")
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            help="Weights to start from.", show_default="random ones", rich_help_panel="Network"
        ),
    ] = None,
    label_space: options.LabelSpaceOption = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            help="Name of a sensor or a .toml file.",
            show_default="the one of --weights, else hdl64",
            rich_help_panel="Network",
        ),
    ] = None,
    device: options.Device = "auto",
    jobs: options.Jobs = 1,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Train a network; run again to go on after an interruption.

    Example: salsanext train streets/ runs/street --recipe street
    """
    from salsanext_cli.stages.train import train as learn
    from salsanext_cli.training.distributed import group_of_environment
    from salsanext_cli.training.overrides import read_overrides
    from salsanext_cli.training.recipe import recipe as find

    is_main = group_of_environment().is_main
    quiet = quiet or not is_main
    output = console.Output(json and is_main, verbose and is_main, quiet)
    with progress("train", quiet, unit="steps") as bar:
        plan = find(recipe).with_changes(**read_overrides(changes or ()))
        done = learn(
            dataset,
            run,
            recipe=plan if epochs is None else plan.with_changes(epochs=epochs),
            sensor=options.sensor(sensor) if sensor else None,
            space=options.label_space(label_space),
            device=device,
            jobs=jobs,
            weights=weights,
            overwrite=overwrite,
            progress=lambda report: _tell(report, bar, output),
        )
    best = f"{100 * done.best_miou:.1f} %"
    paths = {"best": str(done.best), "last": str(done.last)}
    output.result({"stage": "train", "best_miou": done.best_miou, **paths})
    output.say(f"train: best validation mIoU {best} → {done.best}")


def _tell(report: "Report", bar: "Progress | None", output: console.Output) -> None:
    """Move the bar at every step; say how an epoch ended."""
    if bar is not None:
        bar(report.step, report.steps)
    if report.row is not None:
        miou = report.row.get("miou")
        scored = "" if miou is None else f", validation mIoU {100 * miou:.1f} %"
        output.say(f"epoch {report.epoch}/{report.epochs}: loss {report.row['loss']:.3f}{scored}")
