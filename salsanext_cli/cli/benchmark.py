# SPDX-License-Identifier: MIT
"""`salsanext benchmark`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options, selection_options
from salsanext_cli.cli.option_groups import Default, Without
from salsanext_cli.cli.progress import progress

LISTED = "projection, network, knn, predict, uncertainty, confusion, cold, help"


def benchmark(
    scans: options.Scans = None,
    *,
    parts: Annotated[
        str, typer.Option(help=f"Parts to measure, such as network,knn. All are {LISTED}.")
    ] = "all",
    rounds: Annotated[int, typer.Option(help="Turns of each side at each part.")] = 3,
    passes: Annotated[
        int, typer.Option(help="Monte-Carlo passes of the baseline that are timed, of 30.")
    ] = 1,
    threads: Annotated[
        int | None, typer.Option(help="Threads of each side.", show_default="as usual")
    ] = None,
    write: Annotated[Path | None, typer.Option(help="File for every measurement (.json).")] = None,
    selection: Annotated[selection_options.Selection, Default(limit=4)],
    network: Annotated[
        options.NetworkOptions, Without({"intensity", "min_range", "ego"}), Default(intensity="raw")
    ],
    running: run_options.Overwriting,
    output: console.Output,
) -> None:
    """Measure the speed of each part of the method beside a plain implementation of it.

    Example: salsanext benchmark seq/velodyne --parts network,predict --write speed.json
    """
    from salsanext_cli.benchmarking.benchmark import PARTS
    from salsanext_cli.benchmarking.benchmark import benchmark as run
    from salsanext_cli.files.atomic import require_absent
    from salsanext_cli.files.json_files import write_json
    from salsanext_cli.report.tables import benchmark_table

    if write is not None:
        require_absent(write, running.overwrite)
    with progress("benchmark", output.quiet, "parts") as advance:
        found = run(
            selection.source(scans),
            network=network.settings(sized=True),
            selection=selection.scans(),
            parts=PARTS if parts == "all" else [name.strip() for name in parts.split(",")],
            rounds=rounds,
            passes=passes,
            threads=threads,
            progress=advance,
        )
    if write is not None:
        write_json(write, found)
        output.say(f"benchmark: every measurement → {write}")
    output.result({"stage": "benchmark", **found}, benchmark_table(found))
