# SPDX-License-Identifier: MIT
"""`salsanext benchmark`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options
from salsanext_cli.cli.option_groups import Default
from salsanext_cli.cli.progress import progress

LISTED = "projection, network, knn, predict, uncertainty, confusion, cold, help"


def benchmark(
    scans: options.Scans = None,
    *,
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
    selection: Annotated[options.Selection, Default(limit=4)],
    network: options.NetworkOptions,
    running: run_options.Overwriting,
    output: console.Output,
) -> None:
    """Say how fast each part is beside the method written plainly, both measured now and here.

    Example: salsanext benchmark seq/velodyne --parts network,predict --write speed.json
    """
    from salsanext_cli.benchmarking.benchmark import PARTS, Plan, require_new
    from salsanext_cli.benchmarking.benchmark import benchmark as run
    from salsanext_cli.benchmarking.table import benchmark_table
    from salsanext_cli.storage.json_files import write_json

    if write is not None and not running.overwrite:
        require_new(write)
    named = PARTS if parts == "all" else tuple(name.strip() for name in parts.split(","))
    with progress("benchmark", output.quiet, "turns") as advance:
        found = run(
            selection.source(scans),
            network=network.settings(),
            selection=selection.scans(),
            plan=Plan(named, rounds, passes, threads),
            progress=advance,
        ).to_dict()
    if write is not None:
        write_json(write, found)
        output.say(f"benchmark: every measurement → {write}")
    output.result(found, benchmark_table(found))
