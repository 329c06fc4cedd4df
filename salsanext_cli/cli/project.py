# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path
from typing import Annotated

from salsanext_cli.cli import console, options, run_end, run_options, selection_options
from salsanext_cli.cli.option_groups import Without


def project(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    selection: selection_options.SourceSelection,
    network: Annotated[
        options.NetworkOptions, Without({"device", "precision", "engine", "intensity"})
    ],
    running: run_options.Checked,
    output: console.Output,
) -> None:
    """Project scans onto range images and write these, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.stages.project import project_scans

    with running.over_scans("project", output) as run:
        outcome = project_scans(
            selection.source(scans),
            out,
            sensor=network.named_sensor() or network.trained_sensor(),
            fit=network.is_fitted,
            selection=selection.scans(),
            options=run,
        )
    sensor = None if network.sensor == options.AUTO else network.sensor
    named = {"--weights": network.weights, "--sensor": sensor}
    more = [word for name, value in named.items() if value for word in (name, str(value))]
    run_end.finish("project", outcome, out, output, *more, strict=running.strict)
