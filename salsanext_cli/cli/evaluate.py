# SPDX-License-Identifier: MIT
"""`salsanext eval`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


@console.guarded
def evaluate(
    by_distance: Annotated[
        bool, typer.Option("--by-distance", help="Score rings of distance too.")
    ] = False,
    out: options.OutOption = Path("out"),
    dataset: options.DataSetOfResults = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    label_space: options.LabelSpaceOption = None,
    jobs: run_options.Jobs = None,
    backend: run_options.BackendOption = run_options.Backend.loky,
    scheduler: run_options.Scheduler = None,
    overwrite: options.Overwrite = False,
    on_error: options.OnErrorOption = options.OnError.skip,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Example: salsanext eval --split valid
    """
    from rich.console import Group

    from salsanext_cli.report.tables import ring_table, score_table, uncertainty_tables
    from salsanext_cli.stages.evaluate import evaluate as run
    from salsanext_cli.storage.predictions import predicted_scans, provenance

    output = console.Output(json, verbose, quiet)
    wanted = options.choice(split, sequences, limit)
    files, space = predicted_scans(
        out, wanted, dataset, options.label_space(label_space), options.usual_dataset()
    )
    runs = run_options.gather(jobs, backend, scheduler, on_error, overwrite)
    with console.batch("eval", output, runs) as batch:
        settings = provenance(out, wanted, dataset)
        evaluation = run(files, out, space, batch, by_distance=by_distance, settings=settings)
    tables = [score_table(evaluation.scores)]
    if by_distance:
        tables.append(ring_table(evaluation.by_distance))
    tables += uncertainty_tables(evaluation.uncertainty)
    output.result(evaluation.to_dict(), Group(*tables))
    console.name_failures(evaluation.failures)
    counted = f"{evaluation.scans} scans{evaluation.absent.words('predictions')}"
    output.say(f"eval: {counted} → {out}/scores.txt, eval.json, eval_*.png")
    incomplete = evaluation.failures or evaluation.absent.missing
    raise typer.Exit(console.FAILED if incomplete else console.DONE)
