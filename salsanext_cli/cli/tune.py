# SPDX-License-Identifier: MIT
"""`salsanext tune`: one command for each part of the weights that is fitted afterwards."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from salsanext_cli.cli import arguments, console
from salsanext_cli.cli.console import guarded, progress
from salsanext_cli.cli.expansion import Default, expanded
from salsanext_cli.cli.help import Command, Group
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
    """Fit the temperature that calibrates the class probabilities, and write new weights.

    Example: salsanext tune temperature scenes/ tuned.safetensors
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
    """Fit the estimate of the probability that a label is wrong, and write new weights.

    Example: salsanext tune error scenes/ trusted.safetensors
    """
    from salsanext_cli.report.tables import error_table

    tuned = _tuned("error", dataset, target, settings, selection, overwrite, output)
    output.result(tuned, error_table(tuned) if tuned["folds"] else None)
    points = f"{tuned['points']:,} points of {counted(tuned['scans'], 'scan')}"
    points += f", {100 * tuned['wrong']:.1f} % wrong"
    if several := tuned["several"]:
        points += f" ({several:.1%} of all points skipped: labels of several merged classes)"
    _end(output, f"tune error: {points} → {target}", target, "--error ")


def tune_risk(
    dataset: arguments.LabelledDataSet,
    target: arguments.WeightsOut,
    *,
    at_most: Annotated[
        str,
        typer.Option(
            metavar="SHARE", help="Largest share of accepted, wrong points in a scan, such as 5%."
        ),
    ],
    confidence: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE",
            help="Guarantee the limit for this share of scans, with this confidence, instead of on "
            "average, such as 90%.",
        ),
    ] = None,
    per_class: Annotated[
        bool,
        typer.Option(
            "--per-class",
            help="Also guarantee the limit for the points of every class, by one threshold each.",
        ),
    ] = False,
    selection: arguments.LabelledSelection,
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Choose the threshold of `predict --reject risk`, and write new weights.

    Example: salsanext tune risk scenes/ safe.safetensors --at-most 5%
    """
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report.tables import kept_table

    level, sure = (
        arguments.share("--at-most", at_most),
        arguments.share("--confidence", confidence),
    )
    numbers = {"at_most": level, "confidence": sure, "per_class": per_class}
    tuned = _tuned("risk", dataset, target, settings, selection, overwrite, output, **numbers)
    sentences = (Text(sentence) for sentence in tuned["sentences"])
    output.result(
        tuned, Group(kept_table(tuned["kept"]["classes"], tuned.get("classes", {})), *sentences)
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
    seed: Annotated[int, typer.Option(help="Random seed of the dropout masks.")] = 0,
    selection: Annotated[arguments.LabelledSelection, Default(limit=20)],
    settings: arguments.Network,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Find the best dropout rate for `uncertainty`, and write new weights.

    Example: salsanext tune dropout scenes/ sampled.safetensors
    """
    from salsanext_cli.report.tables import rate_table

    rates = {"samples": samples, "seed": seed, "lowest": lowest, "highest": highest, "steps": steps}
    tuned = _tuned("dropout", dataset, target, settings, selection, overwrite, output, **rates)
    best = tuned["best"]
    output.result(tuned, rate_table(tuned["rates"], tuned["objectives"], best))
    summary = f"tune dropout: {best:.4g}, was {tuned['before']:g} → {target}"
    _end(output, summary, target, stage="uncertainty")


def _end(
    output: console.Output, summary: str, target: Path, option: str = "", stage: str = "predict"
) -> None:
    """Print the summary and the usual next command."""
    output.print(summary)
    output.print(f"next: salsanext {stage} SCANS OUT {option}--weights {shlex.quote(str(target))}")


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
    """Fit a part of the weights; return the result as plain data."""
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
    cls=Group,
    rich_markup_mode=None,
    help="Fit weights to labelled scans: temperature, error model, risk threshold, dropout rate.",
)
tune.command("error", cls=Command)(guarded(expanded(tune_error)))
tune.command("risk", cls=Command)(guarded(expanded(tune_risk)))
tune.command("temperature", cls=Command)(guarded(expanded(tune_temperature)))
tune.command("dropout", cls=Command)(guarded(expanded(tune_dropout)))
