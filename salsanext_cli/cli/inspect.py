# SPDX-License-Identifier: MIT
"""`salsanext inspect`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection


def inspect(
    scans: options.Scans = None,
    *,
    fit: Annotated[
        Path | None,
        typer.Option(help="Write a sensor file (.toml) with view, beams, statistics of the scans."),
    ] = None,
    height: Annotated[int | None, typer.Option(help="Rows of its range image.")] = None,
    width: Annotated[int | None, typer.Option(help="Columns of its range image.")] = None,
    dataset: options.DataSet = None,
    selection: ScanSelection,
    topic: options.Topic = None,
    label_space: options.LabelSpaceName = None,
    sensor: options.SensorWithoutWeights = None,
    columns: options.Columns = None,
    running: options.Unsharded,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Summarise a set of scans; fit a sensor to them.

    Example: salsanext inspect my/scans --fit my-sensor.toml --height 32 --width 1024
    """
    from salsanext_cli.fitting.view_fit import view_text
    from salsanext_cli.report.tables import survey_tables
    from salsanext_cli.sensors.sensor import sensor as find_sensor
    from salsanext_cli.stages.inspect import inspect as stage
    from salsanext_cli.stages.inspect import write_sensor

    view = options.with_columns(find_sensor(sensor or "hdl64"), columns).resized(height, width)
    with over_scans("inspect", running, output.quiet) as run:
        found = stage(
            options.source(scans, dataset, topic),
            sensor=view,
            space=options.label_space(label_space),
            selection=selection,
            options=run,
            fit=fit is not None,
        )
    if fit is not None:
        # For weights to come; those that are there have a size and normalisation of their own.
        images = height is not None or width is not None
        fitted = found.fitted_sensor(fit.stem, images=images)
        write_sensor(fit, fitted, images=images, overwrite=running.overwrite)
        beams = f", {len(fitted.beams)} beams" if fitted.beams else ", beams not discernible"
        output.say(f"inspect: sensor, {view_text(fitted)}{beams} → {fit}")
    tables = survey_tables(found.sequences, found.total, found.space, found.sensor)
    output.result(found.to_dict(), tables)
    run_end.name_failures(found.failures)
    for line in run_end.warning_lines(found.warnings):
        output.say(line)
    run_end.leave(found.failures, failed=strict and bool(found.warnings))
