# SPDX-License-Identifier: MIT
"""`salsanext report`."""

from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.errors import counted
from salsanext_cli.options import ScanSelection


def report(
    *,
    results: options.Results,
    scans: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Scans to show point by point, such as 08/000000,08/000010.",
            show_default="up to four that are worth looking at",
        ),
    ] = None,
    by_distance: options.ByDistance = False,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: options.Reading,
    output: console.Output,
) -> None:
    """Write one page of a run that opens in any browser: numbers, plots, and scans in 3-D.

    Example: salsanext report out/
    """
    from salsanext_cli.stages.report import report as stage

    with over_scans("report", running, output.quiet) as run:
        made = stage(
            results.folder(),
            scans=[name.strip() for name in (scans or "").split(",") if name.strip()],
            dataset=dataset,
            space=options.label_space(label_space),
            classes=options.label_space(classes),
            by_distance=by_distance,
            selection=selection,
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
