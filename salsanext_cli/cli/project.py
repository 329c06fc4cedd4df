# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path

from salsanext_cli.cli import console, options, run_options


@console.guarded
def project(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    dataset: options.DataSet = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    weights: options.Weights = None,
    sensor: options.Sensor = None,
    jobs: run_options.Jobs = None,
    backend: run_options.BackendOption = run_options.Backend.loky,
    scheduler: run_options.Scheduler = None,
    shard: run_options.Share = None,
    overwrite: options.Overwrite = False,
    on_error: options.OnErrorOption = options.OnError.skip,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Project scans to range images on disk, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.stages.project import project_scans

    output = console.Output(json, verbose, quiet)
    runs = run_options.gather(
        jobs, backend, scheduler, on_error, overwrite, run_options.share(shard, output)
    )
    with console.batch("project", output, runs) as batch:
        outcome = project_scans(
            options.source(scans, dataset),
            out,
            sensor=options.sensor(sensor) if sensor else options.sensor_of(weights),
            selection=options.choice(split, sequences, limit),
            options=batch,
        )
    console.finish("project", outcome, out, output)
