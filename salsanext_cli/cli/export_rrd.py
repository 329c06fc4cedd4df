# SPDX-License-Identifier: MIT
"""`salsanext export-rrd`."""

from typing import Annotated

from salsanext_cli.cli import console, options, run_end, run_options, selection_options
from salsanext_cli.cli.option_groups import Default, Without


def export_rrd(
    *,
    results: selection_options.Results,
    selection: selection_options.ResultSelection,
    classes: selection_options.Classes,
    merged: options.MergedClasses,
    running: Annotated[
        run_options.Running,
        Without({"jobs", "backend", "scheduler", "shard", "overwrite"}),
        Default(shard="1/1"),
    ],
    output: console.Output,
) -> None:
    """Write recordings for the Rerun viewer that hold every known value of every point.

    Example: salsanext export-rrd out/
    """
    from salsanext_cli.stages.export_rrd import export_rrd as stage

    out = results.folder()
    with running.over_scans("export-rrd", output) as run:
        outcome = stage(
            out,
            dataset=selection.dataset,
            space=classes.space(),
            classes=merged.space(),
            selection=selection.scans(),
            options=run,
        )
    run_end.finish("export-rrd", outcome, out, output)
