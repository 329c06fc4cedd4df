# SPDX-License-Identifier: MIT
"""`salsanext knn-refine`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


def knn_refine(
    out: options.Out = Path("out"),
    *,
    labels: Annotated[
        Path | None,
        typer.Option(help="Refine the .label files of this folder instead, of any program."),
    ] = None,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            help=options.SENSOR_HELP,
            show_default="the sensor of the earlier stages, else hdl64",
            rich_help_panel="Network",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help=options.COLUMNS_HELP,
            show_default="those of the earlier stages, else x,y,z,intensity",
            rich_help_panel="Network",
        ),
    ] = None,
    knn: options.Knn,
    running: RunOptions,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Turn labels of pixels into labels of points, or correct labels of points, by neighbours.

    Example: salsanext knn-refine out/
    """
    from salsanext_cli.results.stage_records import StageRecords
    from salsanext_cli.stages.knn_refine import knn_refine_scans

    seen = options.sensor(sensor)
    if columns is not None:
        seen = options.with_columns(seen or StageRecords(out).sensor(), columns)
    with over_scans("knn-refine", running, output.quiet) as run:
        outcome = knn_refine_scans(
            out,
            labels=labels,
            dataset=dataset,
            sensor=seen,
            space=options.label_space(label_space),
            knn=knn.parameters(),
            selection=selection,
            options=run,
        )
    run_end.finish("knn-refine", outcome, out, output, split=selection.split, strict=strict)
