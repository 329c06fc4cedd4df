# SPDX-License-Identifier: MIT
"""`salsanext benchmark`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress

LISTED = "projection, network, knn, predict, uncertainty, confusion, cold, help"


@console.guarded
def benchmark(
    scans: options.Scans = None,
    parts: Annotated[
        str, typer.Option(help=f"Only some of {LISTED}, such as network,knn.")
    ] = "all",
    rounds: Annotated[int, typer.Option(help="Turns of each side.")] = 3,
    passes: Annotated[
        int, typer.Option(help="Of the baseline's 30 Monte-Carlo passes, how many are timed.")
    ] = 1,
    threads: Annotated[
        int | None, typer.Option(help="Of both sides.", show_default="as usual")
    ] = None,
    write: Annotated[Path | None, typer.Option(help="Write every measurement, .json.")] = None,
    dataset: options.DataSet = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = 4,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    sensor: options.Sensor = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Say how fast each part is beside the method written plainly, both measured now and here.

    Example: salsanext benchmark seq/velodyne --parts network,predict --write speed.json
    """
    from salsanext_cli.benchmarking.benchmark import PARTS, Plan, require_new
    from salsanext_cli.benchmarking.benchmark import benchmark as run
    from salsanext_cli.benchmarking.table import benchmark_table
    from salsanext_cli.storage.json_files import write_json

    output = console.Output(json, verbose, quiet)
    if write is not None and not overwrite:
        require_new(write)
    named = PARTS if parts == "all" else tuple(name.strip() for name in parts.split(","))
    with progress("benchmark", output.quiet, "turns") as advance:
        found = run(
            options.source(scans, dataset),
            network=options.network(weights, device, sensor, precision),
            selection=options.choice(split, sequences, limit),
            plan=Plan(named, rounds, passes, threads),
            progress=advance,
        ).to_dict()
    if write is not None:
        write_json(write, found)
        output.say(f"benchmark: every measurement → {write}")
    output.result(found, benchmark_table(found))
