# SPDX-License-Identifier: MIT
"""`salsanext tune`: a group of commands, one for each part of the weights that can be fitted."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from salsanext_cli.cli import arguments, console
from salsanext_cli.cli.console import guarded, progress
from salsanext_cli.cli.expansion import Default, Shown, Without, expanded
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import counted
from salsanext_cli.option_fields import ScanSelection


def tune_temperature(
    dataset: arguments.LabelledDataSet,
    target: arguments.WeightsOut,
    *,
    selection: arguments.LabelledSelection,
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Fit the temperature that calibrates the probabilities, and write new weights.

    Example: salsanext tune temperature streets/ tuned.safetensors --limit 50
    """
    from salsanext_cli.report.tables import temperature_table

    tuned = _tuned("temperature", dataset, target, settings, selection, overwrite, output)
    output.result(tuned, temperature_table(tuned))
    points = f"{tuned['points']:,} points of {counted(tuned['scans'], 'scan')}"
    _end(output, f"tune temperature: {points} → {target}", target)


def tune_error(
    dataset: arguments.LabelledDataSet,
    target: arguments.WeightsOut,
    *,
    selection: arguments.LabelledSelection,
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Fit the probability that a label is wrong, and write new weights.

    Example: salsanext tune error streets/ tuned.safetensors
    """
    from salsanext_cli.report.tables import error_table

    tuned = _tuned("error", dataset, target, settings, selection, overwrite, output)
    output.result(tuned, error_table(tuned) if tuned["folds"] else None)
    points = f"{tuned['points']:,} points of {counted(tuned['scans'], 'scan')}"
    points += f", {100 * tuned['wrong']:.1f} % wrong"
    if several := tuned["several"]:
        points += f" ({several:.1%} of all skipped: labels of several classes, which eval counts)"
    _end(output, f"tune error: {points} → {target}", target, "--error ")


def tune_risk(
    dataset: arguments.LabelledDataSet,
    target: arguments.WeightsOut,
    *,
    at_most: Annotated[
        str,
        typer.Option(
            metavar="SHARE", help="Share of a scan's points that may be kept and wrong, such as 5%."
        ),
    ],
    confidence: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE",
            help="Hold it, with this confidence, in at least this share of scans, such as 90%.",
            show_default="on the mean of scans",
        ),
    ] = None,
    per_class: Annotated[
        bool,
        typer.Option(
            "--per-class",
            help="Hold it of the points of each label, too, by thresholds of their own.",
        ),
    ] = False,
    selection: arguments.LabelledSelection,
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Choose the threshold of `predict --reject risk`, and write new weights.

    Example: salsanext tune risk streets/ safe.safetensors --at-most 5%
    """
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report.tables import accepted_table

    level, sure = (
        arguments.share("--at-most", at_most),
        arguments.share("--confidence", confidence),
    )
    numbers = {"at_most": level, "confidence": sure, "per_class": per_class}
    tuned = _tuned("risk", dataset, target, settings, selection, overwrite, output, **numbers)
    sentences = (Text(sentence) for sentence in tuned["sentences"])
    output.result(
        tuned, Group(accepted_table(tuned["kept"]["classes"], tuned.get("classes", {})), *sentences)
    )
    summary = f"tune risk: {tuned['promise']} → {target}, {tuned['curve']}"
    _end(output, summary, target, "--reject risk ")


def tune_dropout(
    dataset: arguments.LabelledDataSet,
    target: arguments.WeightsOut,
    *,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan and rate.")] = 30,
    lowest: Annotated[float, typer.Option(help="Lowest rate to try.")] = 0.02,
    highest: Annotated[float, typer.Option(help="Highest rate to try.")] = 0.5,
    steps: Annotated[
        int, typer.Option(help="Number of rates to try, evenly spaced on a log scale.")
    ] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the dropout masks.")] = 0,
    selection: Annotated[arguments.LabelledSelection, Default(limit=20)],
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Find the dropout rate to sample with, and write new weights.

    Example: salsanext tune dropout streets/ tuned.safetensors --steps 10
    """
    from salsanext_cli.report.tables import rate_table

    rates = {"samples": samples, "seed": seed, "lowest": lowest, "highest": highest, "steps": steps}
    tuned = _tuned("dropout", dataset, target, settings, selection, overwrite, output, **rates)
    best = tuned["best"]
    output.result(tuned, rate_table(tuned["rates"], tuned["objectives"], best))
    summary = f"tune dropout: {best:.4g}, was {tuned['before']:g} → {target}"
    _end(output, summary, target, stage="uncertainty")


def tune_int8(
    scans: arguments.RequiredScans,
    target: arguments.WeightsOut,
    *,
    selection: Annotated[ScanSelection, Shown(limit=arguments.EVENLY_SPACED)],
    settings: Annotated[arguments.Network, Without({"precision"})],
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Fit the ranges of `predict --precision int8` to scans without labels; write new weights.

    Example: salsanext tune int8 seq/velodyne faster.safetensors
    """
    from salsanext_cli.stages.tune import tune_int8 as stage

    report = stage(scans, target, settings=settings, selection=selection, overwrite=overwrite)
    output.result(report | {"weights": str(target)})
    equal = "" if report["equal"] is None else f", {report['equal']:.1%} of the labels equal"
    summary = f"tune int8: {counted(report['scans'], 'scan')}{equal} → {target}"
    _end(output, summary, target, "--precision int8 ")


def _end(
    output: console.Output, summary: str, target: Path, option: str = "", stage: str = "predict"
) -> None:
    """Print the last lines: what was fitted, and the command that most users type next."""
    output.say(summary)
    output.say(f"next: salsanext {stage} SCANS OUT {option}--weights {shlex.quote(str(target))}")


def _tuned(
    part: str,
    source: Path,
    target: Path,
    settings: NetworkSettings,
    selection: ScanSelection,
    overwrite: bool,
    output: console.Output,
    **numbers: float | None,
) -> dict[str, Any]:
    """Fit a part of the weights; return plain data."""
    from salsanext_cli.stages.tune import tune

    unit = "samplings" if part == "dropout" else "scans"
    with progress(f"tune {part}", output.quiet, unit) as on_progress:
        tuned = tune(
            part,
            source,
            target,
            settings=settings,
            selection=selection,
            overwrite=overwrite,
            progress=on_progress,
            **numbers,
        )
    return tuned | {"weights": str(target)}


tune = typer.Typer(
    no_args_is_help=True,
    help="Fit weights to scans: temperature, error, threshold of risk, dropout rate, int8 ranges.",
)
tune.command("error")(guarded(expanded(tune_error)))
tune.command("risk")(guarded(expanded(tune_risk)))
tune.command("temperature")(guarded(expanded(tune_temperature)))
tune.command("dropout")(guarded(expanded(tune_dropout)))
tune.command("int8")(guarded(expanded(tune_int8)))
