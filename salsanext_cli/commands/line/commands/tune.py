# SPDX-License-Identifier: MIT
"""`salsanext tune`: one command for each part of the weights that is fitted afterwards."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Declared, Default, Without, expanded
from salsanext_cli.commands.line.options.option_fields import (
    DeclarationChange,
    argument,
    option,
    option_group,
    running_option,
)
from salsanext_cli.commands.line.output import console
from salsanext_cli.commands.line.output.console import guarded
from salsanext_cli.commands.line.output.help import Command, Group
from salsanext_cli.commands.line.output.progress import writing
from salsanext_cli.commands.line.values.typed_values import typed_share
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_selection import ScanSelection


@option_group
class Fit:
    """Labelled scans, network and weights file of a fit."""

    selection: ScanSelection = ScanSelection()
    settings: NetworkSettings = NetworkSettings()
    overwrite: bool = running_option("Replace existing results.", default=False)


FitOptions = Annotated[
    Fit,
    Declared(
        split=DeclarationChange(show_default="valid, and the sequences of no split"),
        limit=declarations.SUBSET,
    ),
    Default(precision="auto"),
]


def tune_temperature(
    dataset: Path = declarations.labelled_argument(default=...),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    fit: FitOptions,
    output: console.Output,
) -> None:
    """Fit the temperature that calibrates the class probabilities, and write new weights.

    Example: salsanext tune temperature scenes/ tuned.safetensors
    """
    from salsanext_cli.commands.line.output.tune_tables import temperature_table
    from salsanext_cli.commands.stages.tune import tune_temperature as stage

    with writing("tune temperature", output.quiet, at_end=True) as bar:
        tuned = stage(
            dataset,
            target,
            settings=fit.settings,
            selection=fit.selection,
            overwrite=fit.overwrite,
            progress=bar,
        )
    output.result(tuned.to_dict(), temperature_table(tuned.fit))
    points = f"{tuned.fit.points:,} points of {counted(tuned.fit.scans, 'scan')}"
    _end(output, f"tune temperature: {points} → {target}", target)


def tune_error(
    dataset: Path = declarations.labelled_argument(default=...),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    fit: FitOptions,
    output: console.Output,
) -> None:
    """Fit the estimate of the probability that a label is wrong, and write new weights.

    Example: salsanext tune error scenes/ trusted.safetensors
    """
    from salsanext_cli.commands.line.output.tune_tables import error_table
    from salsanext_cli.commands.stages.tune import tune_error as stage

    with writing("tune error", output.quiet, at_end=True) as bar:
        tuned = stage(
            dataset,
            target,
            settings=fit.settings,
            selection=fit.selection,
            overwrite=fit.overwrite,
            progress=bar,
        )
    held_out = tuned.fit.held_out
    output.result(tuned.to_dict(), error_table(held_out) if held_out.folds else None)
    points = f"{tuned.fit.points:,} points of {counted(tuned.fit.scans, 'scan')}"
    points += f", {percentage(tuned.fit.wrong)} wrong"
    share_of_several = tuned.fit.several
    if share_of_several:
        skipped = f"{percentage(share_of_several)} of all points skipped"
        points += f" ({skipped}: labels of several merged classes)"
    _end(output, f"tune error: {points} → {target}", target, "--error ")


def tune_risk(
    dataset: Path = declarations.labelled_argument(default=...),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    at_most: str = option(
        "Limit on the share of the points of known classes that are accepted and wrong, such as "
        "5%. Without `--confidence` it limits the average over scans or drives.",
        default=...,
        metavar="SHARE",
    ),
    confidence: str | None = option(
        "Instead of an average: with this confidence, at least this share of scans (or drives) "
        "stays within the limit, such as 90%. The others may exceed it by any amount.",
        metavar="SHARE",
    ),
    record: Path | None = option(
        "Also write a dated record to archive: threshold, scans with digests, weights, settings "
        "and check, as JSON.",
        metavar="FILE",
    ),
    fit: FitOptions,
    output: console.Output,
) -> None:
    """Choose the threshold of `predict --reject risk`, and write new weights.

    Example: salsanext tune risk scenes/ safe.safetensors --at-most 5%
    """
    from salsanext_cli.commands.line.output.tune_tables import risk_tables
    from salsanext_cli.commands.stages.tune import tune_risk as stage
    from salsanext_cli.io.files.atomic import require_target
    from salsanext_cli.report.tables import needed_scans_table
    from salsanext_cli.training.tuning.risk_level import TooFewScansError
    from salsanext_cli.training.tuning.risk_record import write_risk_record

    if record:
        require_target(record, fit.overwrite, ".json")
    limit = typed_share("--at-most", at_most)
    share_of_units = typed_share("--confidence", confidence)
    try:
        with writing("tune risk", output.quiet, at_end=True) as bar:
            tuned = stage(
                dataset,
                target,
                at_most=limit,
                confidence=share_of_units,
                settings=fit.settings,
                selection=fit.selection,
                overwrite=fit.overwrite,
                progress=bar,
            )
    except TooFewScansError:
        output.explain(needed_scans_table(limit, share_of_units))
        raise
    if record:
        write_risk_record(
            record,
            tuned.fit,
            source=dataset,
            weights=fit.settings.path,
            target=target,
            overwrite=fit.overwrite,
        )
    output.result(tuned.to_dict(), risk_tables(tuned.fit))
    written = ", ".join(str(path) for path in (target, tuned.picture, record) if path)
    _end(output, f"tune risk: {tuned.fit.guarantee} → {written}", target, "--reject risk ")


def tune_dropout(
    dataset: Path = declarations.labelled_argument(default=...),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    samples: int = option("Monte-Carlo passes per scan and rate.", default=30),
    fit: Annotated[FitOptions, Default(limit=20)],
    output: console.Output,
) -> None:
    """Find the best dropout rate for `uncertainty`, and write new weights.

    Example: salsanext tune dropout scenes/ sampled.safetensors
    """
    from salsanext_cli.commands.stages.tune import tune_dropout as stage
    from salsanext_cli.report.tables import rate_table

    with writing("tune dropout", output.quiet, at_end=True) as bar:
        tuned = stage(
            dataset,
            target,
            samples=samples,
            settings=fit.settings,
            selection=fit.selection,
            overwrite=fit.overwrite,
            progress=bar,
        )
    best = tuned.fit.best
    output.result(tuned.to_dict(), rate_table(tuned.fit.rates, tuned.fit.objectives, best))
    summary = f"tune dropout: {best:.4g}, was {tuned.fit.before:g} → {target}"
    _end(output, summary, target, stage="uncertainty")


def tune_int8(
    scans: Path = argument(declarations.SCANS_HELP, default=..., metavar="SCANS"),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    fit: Annotated[
        Fit,
        Without({"device", "precision", "engine"}),
        Declared(split=DeclarationChange(show_default="all scans"), limit=declarations.SUBSET),
        Default(limit=16),
    ],
    output: console.Output,
) -> None:
    """Fit the ranges of `predict --precision int8` to scans without labels; write new weights.

    Example: salsanext tune int8 scenes/ fast.safetensors
    """
    from salsanext_cli.commands.stages.tune import tune_int8 as stage

    tuned = stage(
        scans, target, settings=fit.settings, selection=fit.selection, overwrite=fit.overwrite
    )
    output.result(tuned.to_dict())
    summary = f"tune int8: {counted(tuned.scans, 'scan')} → {target}"
    _end(output, summary, target, "--precision int8 ")


def _end(
    output: console.Output, summary: str, target: Path, option: str = "", stage: str = "predict"
) -> None:
    """Print the summary and the usual next command."""
    output.print(summary)
    output.print(f"next: salsanext {stage} SCANS OUT {option}--weights {shlex.quote(str(target))}")


tune = typer.Typer(
    cls=Group,
    rich_markup_mode=None,
    help="Fit weights to scans: temperature, error model, risk threshold, dropout rate, int8.",
)
tune.command("error", cls=Command)(guarded(expanded(tune_error)))
tune.command("risk", cls=Command)(guarded(expanded(tune_risk)))
tune.command("temperature", cls=Command)(guarded(expanded(tune_temperature)))
tune.command("dropout", cls=Command)(guarded(expanded(tune_dropout)))
tune.command("int8", cls=Command)(guarded(expanded(tune_int8)))
