# SPDX-License-Identifier: MIT
"""`salsanext report`."""

from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end, run_options, selection_options
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.errors import counted


def report(
    *,
    results: selection_options.Results,
    scans: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Scans to show point by point, such as 08/000000,08/000010.",
            show_default="up to four that are worth looking at",
        ),
    ] = None,
    by_distance: options.ByDistance = False,
    selection: selection_options.ResultSelection,
    classes: selection_options.Classes,
    merged: options.MergedClasses,
    running: Annotated[run_options.RunningUnsharded, Without({"overwrite"})],
    output: console.Output,
) -> None:
    """Write one page of a run that opens in any browser: numbers, plots, and scans in 3-D.

    Example: salsanext report out/
    """
    from salsanext_cli.stages.report import report as stage

    with running.over_scans("report", output) as run:
        made = stage(
            results.folder(),
            scans=[name.strip() for name in (scans or "").split(",") if name.strip()],
            dataset=selection.dataset,
            space=classes.space(),
            classes=merged.space(),
            by_distance=by_distance,
            selection=selection.scans(),
            options=run,
        )
    output.result(made.to_dict())
    run_end.name_failures(made.failures)
    for name, reason in made.shown.items():
        output.say(f"  {name}: {reason}")
    left_out = run_end.left_out(made.missing)
    size = f"{made.bytes / 1e6:.1f} MB"
    output.say(f"report: {counted(made.scans, 'scan')}{left_out} → {made.page} ({size})")
    run_end.leave(made.failures, made.missing)
