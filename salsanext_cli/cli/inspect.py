# SPDX-License-Identifier: MIT
"""`salsanext inspect`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


@console.guarded
def inspect(
    scans: options.Scans = None,
    fit: Annotated[
        Path | None,
        typer.Option(help="Write a sensor with these scans' view and normalisation, .toml."),
    ] = None,
    height: Annotated[int | None, typer.Option(help="Rows of its range image.")] = None,
    width: Annotated[int | None, typer.Option(help="Columns of its range image.")] = None,
    dataset: options.DataSet = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    label_space: options.LabelSpaceOption = None,
    sensor: options.SensorWithoutWeights = None,
    jobs: run_options.Jobs = None,
    backend: run_options.BackendOption = run_options.Backend.loky,
    scheduler: run_options.Scheduler = None,
    overwrite: options.Overwrite = False,
    on_error: options.OnErrorOption = options.OnError.skip,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Say what is in a set of scans; fit a sensor to them.

    Example: salsanext inspect my/scans --fit my-sensor.toml --height 32 --width 1024
    """
    from salsanext_cli.report.surveys import survey_tables
    from salsanext_cli.stages.inspect import inspect as run
    from salsanext_cli.stages.inspect import write_sensor

    output = console.Output(json, verbose, quiet)
    view = options.sensor(sensor or "hdl64").resized(height, width)
    runs = run_options.gather(jobs, backend, scheduler, on_error)
    with console.batch("inspect", output, runs) as batch:
        found = run(
            options.source(scans, dataset),
            sensor=view,
            space=options.label_space(label_space),
            selection=options.choice(split, sequences, limit),
            options=batch,
            fit=fit is not None,
        )
    if fit is not None:
        write_sensor(fit, found.fitted_sensor(fit.stem), overwrite=overwrite)
        output.say(f"inspect: sensor → {fit}")
    output.result(
        found.to_dict(), survey_tables(found.sequences, found.total, found.space, found.sensor)
    )
    console.name_failures(found.failures)
    raise typer.Exit(console.FAILED if found.failures else console.DONE)
