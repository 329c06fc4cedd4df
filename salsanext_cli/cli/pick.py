# SPDX-License-Identifier: MIT
"""`salsanext pick`."""

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.option_groups import Shown
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.errors import counted
from salsanext_cli.options import ScanSelection


def pick(
    scans: options.RequiredScans,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Root of the data set to write.")],
    *,
    count: Annotated[int, typer.Option(help="Number of scans to pick.")] = 10,
    strategy: Annotated[
        Literal["both", "uncertainty", "diverse", "random"],
        typer.Option(help="Pick what is uncertain, what is unlike the rest, both, or any."),
    ] = "both",
    seed: Annotated[int, typer.Option(help="Seed of dropout masks and of random picks.")] = 0,
    labelled: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DATASET",
            help="Data set of scans that are labelled already: others are picked, unlike them; may "
            "be given several times.",
        ),
    ] = None,
    selection: Annotated[
        ScanSelection,
        Shown(limit={"help": "Look at this number of scans only, evenly spaced."}),
    ],
    topic: options.Topic = None,
    network: options.NetworkOptions,
    running: options.Unsharded,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Pick the scans most worth labelling; write them as a data set with labels to correct.

    Example: salsanext pick my/drive to-label/ --count 10
    """
    from salsanext_cli.report.picked import picked_table
    from salsanext_cli.stages.pick import pick as stage

    with over_scans("pick", running, output.quiet) as run:
        found = stage(
            options.in_topic(scans, topic),
            out,
            count=count,
            strategy=strategy,
            seed=seed,
            network=network.settings(),
            selection=selection,
            options=run,
            labelled=labelled or (),
        )
    table = picked_table(found.picked) if found.picked else None
    output.result(found.to_dict() | {"out": str(out)}, table)
    outcome, doubted = found.outcome, found.warnings
    run_end.name_failures(outcome.failures)
    already = f", {outcome.skipped} there already" if outcome.skipped else ""
    failed = f", {len(outcome.failures)} failed" if outcome.failures else ""
    chosen = f"{len(found.picked):,} of {counted(found.scans, 'scan')}"
    output.say(f"pick: {chosen}{already}{failed} → {out}")
    for line in run_end.warning_lines(doubted):
        output.say(line)
    if found.picked:
        started = ["--weights", str(network.weights)] if network.weights else []
        following = shlex.join(
            ["salsanext", "train", str(out), "RUN", "--recipe", "finetune", *started]
        )
        edited = shlex.join(["salsanext", "import-labels", "EDITED", str(out)])
        output.say(f"next: correct the labels, take them back with `{edited}`, then `{following}`")
    run_end.leave(outcome.failures, failed=strict and bool(doubted))
