# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import next_command
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.scans_and_out import scans_and_out
from salsanext_cli.core.notices import demote_result_notices
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_selection import ScanSelection

UNUSED_SETTINGS = ("device", "precision", "engine", "intensity")
"""Fields of `NetworkSettings` that range images do not depend on."""


def project(
    context: typer.Context,
    scans: Path | None = declarations.SEVERAL_SCANS,
    out: Path = declarations.OUT,
    *,
    dataset: Path | None = declarations.DATASET,
    selection: ScanSelection,
    topic: str | None = declarations.TOPIC,
    settings: Annotated[
        declarations.Network, Without({"device", "precision", "engine", "intensity"})
    ],
    running: RunOptions,
    dry_run: bool = declarations.DRY_RUN,
    strict: bool = declarations.STRICT,
    output: console.Output,
) -> None:
    """Project scans onto range images, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.commands.stages.project import plan_projection, project_scans

    places = scans_and_out(context, scans, out, dataset, topic)
    source = places.scans
    out = places.out
    sensor = settings.named_sensor() or settings.trained_sensor()
    if dry_run:
        with demote_result_notices():
            plan = plan_projection(
                source,
                out,
                sensor=sensor,
                fit=settings.fits_view,
                fit_mounting=settings.fits_mounting,
                selection=selection,
                options=running,
            )
        print_plan("project", plan, out, output)
        return
    with over_scans("project", running, output.quiet) as options:
        outcome = project_scans(
            source,
            out,
            sensor=sensor,
            fit=settings.fits_view,
            fit_mounting=settings.fits_mounting,
            selection=selection,
            options=options,
        )
    # OUT has the range images, and gets the labels of their pixels.
    following = next_command(outcome, ["predict", out, out], _network_as_typed(settings))
    summary.print_summary_and_exit(
        "project", outcome, out, output, following=following, strict=strict
    )


def _network_as_typed(settings: NetworkSettings) -> list[str]:
    """Return the options by which `predict` takes the network of the range images."""
    from salsanext_cli.runs.results.repeated_settings import settings_as_typed

    weights = {"weights": settings.weights} if settings.weights else {}
    return settings_as_typed(weights | settings.named())
