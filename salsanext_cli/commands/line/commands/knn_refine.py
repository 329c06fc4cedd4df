# SPDX-License-Identifier: MIT
"""`salsanext knn-refine`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import command_on_labels
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.commands.line.values.typed_values import typed_sensor
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.notices import demote_reader_notices
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import named_label_space
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.sensor_request import with_names


def knn_refine(
    out: Path = declarations.RESULTS,
    *,
    dataset: Path | None = declarations.DATASET_OF_RESULTS,
    selection: ScanSelection,
    label_space: str | None = declarations.LABEL_SPACE,
    sensor: str | None = declarations.sensor_option(
        show_default="the sensor of the earlier commands, else hdl64"
    ),
    columns: str | None = declarations.columns_option(
        show_default="columns of the earlier commands, else x,y,z,intensity"
    ),
    knn: KnnParameters,
    running: RunOptions,
    dry_run: bool = declarations.DRY_RUN,
    strict: bool = declarations.STRICT,
    output: console.Output,
) -> None:
    """Assign labels of pixels to points by a vote of the nearest neighbours.

    Example: salsanext knn-refine out/
    """
    from salsanext_cli.commands.stages.knn_refine import knn_refine_scans, plan_refinement
    from salsanext_cli.runs.results.provenance import Provenance

    space = named_label_space(label_space)
    scan_sensor = typed_sensor(sensor)
    if columns is not None:
        scan_sensor = with_names(scan_sensor or Provenance(out).sensor(), columns)
    if dry_run:
        with demote_reader_notices():
            plan = plan_refinement(
                out,
                dataset=dataset,
                sensor=scan_sensor,
                space=space,
                knn=knn,
                selection=selection,
                options=running,
            )
        print_plan("knn-refine", plan, out, output)
        return
    with over_results("knn-refine", running, output.quiet) as options:
        outcome = knn_refine_scans(
            out,
            dataset=dataset,
            sensor=scan_sensor,
            space=space,
            knn=knn,
            selection=selection,
            options=options,
        )
    following = command_on_labels(outcome, out, selection.split)
    summary.print_summary_and_exit(
        "knn-refine", outcome, out, output, following=following, strict=strict
    )
