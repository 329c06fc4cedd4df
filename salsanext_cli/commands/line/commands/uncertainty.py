# SPDX-License-Identifier: MIT
"""`salsanext uncertainty`."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import next_command
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.scans_and_out import scans_and_out
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.notices import demote_result_notices
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.scans.scan_selection import ScanSelection


def uncertainty(
    context: typer.Context,
    scans: Path | None = declarations.SEVERAL_SCANS,
    out: Path = declarations.OUT,
    *,
    samples: int = option("Monte-Carlo passes per scan.", default=30),
    seed: int = option("Random seed of dropout masks and noise.", default=0),
    aleatoric: Literal["copies", "paper", "none"] = option(
        "Method for aleatoric and total uncertainty: eight noisy copies of each scan, or "
        "propagation of the noise through the network as in the paper.",
        default="copies",
    ),
    dataset: Path | None = declarations.DATASET,
    selection: ScanSelection,
    topic: str | None = declarations.TOPIC,
    classes: str | None = declarations.CLASSES,
    settings: declarations.Network,
    knn: KnnParameters,
    running: RunOptions,
    dry_run: bool = declarations.DRY_RUN,
    strict: bool = declarations.STRICT,
    output: console.Output,
) -> None:
    """Predict the class of every point and its epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.commands.stages.uncertainty import plan_uncertainty
    from salsanext_cli.commands.stages.uncertainty import uncertainty as stage
    from salsanext_cli.core.uncertainty.method import UncertaintyMethod

    places = scans_and_out(context, scans, out, dataset, topic)
    source = places.scans
    out = places.out
    settings = replace(settings, classes=classes)
    method = UncertaintyMethod(samples, seed, aleatoric)
    if dry_run:
        with demote_result_notices():
            plan = plan_uncertainty(
                source,
                out,
                settings=settings,
                knn=knn,
                method=method,
                selection=selection,
                options=running,
            )
        print_plan("uncertainty", plan, out, output)
        return
    with over_scans("uncertainty", running, output.quiet) as options:
        outcome = stage(
            source,
            out,
            settings=settings,
            knn=knn,
            method=method,
            selection=selection,
            options=options,
        )
    following = next_command(outcome, ["export-ply", out, "--colour", "uncertainty"])
    summary.print_summary_and_exit(
        "uncertainty", outcome, out, output, following=following, strict=strict
    )
