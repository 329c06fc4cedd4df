# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path

from salsanext_cli.cli import console, options, running


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
    jobs: running.Jobs = None,
    backend: running.BackendOption = running.Backend.loky,
    scheduler: running.Scheduler = None,
    shard: running.Share = None,
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

    talk = console.Talk(json, verbose, quiet)
    runs = running.gather(jobs, backend, scheduler, on_error, overwrite, running.share(shard, talk))
    with console.batch("project", talk, runs) as batch:
        outcome = project_scans(
            options.source(scans, dataset),
            out,
            sensor=options.sensor(sensor) if sensor else options.sensor_of(weights),
            choice=options.choice(split, sequences, limit),
            options=batch,
        )
    console.finish("project", outcome, out, talk)
