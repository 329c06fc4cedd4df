# SPDX-License-Identifier: MIT
"""`salsanext export-rrd`."""

from typing import Annotated

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


def export_rrd(
    *,
    results: options.Results,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: Annotated[RunOptions, Without({"jobs", "backend", "scheduler", "shard", "overwrite"})],
    output: console.Output,
) -> None:
    """Write recordings for the Rerun viewer that hold every known value of every point.

    Example: salsanext export-rrd out/
    """
    from salsanext_cli.stages.export_rrd import export_rrd as stage

    out = results.folder()
    with over_scans("export-rrd", running, output.quiet) as run:
        outcome = stage(
            out,
            dataset=dataset,
            space=options.label_space(label_space),
            classes=options.label_space(classes),
            selection=selection,
            options=run,
        )
    run_end.finish("export-rrd", outcome, out, output)
