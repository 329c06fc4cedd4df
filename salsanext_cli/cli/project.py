# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path
from typing import Annotated

from salsanext_cli.cli import console, options, run_options
from salsanext_cli.cli.option_groups import Without


def project(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    selection: options.SourceSelection,
    network: Annotated[options.NetworkOptions, Without({"device", "precision", "engine"})],
    running: run_options.Running,
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
            sensor=network.sensor_to_project(),
            selection=selection.scans(),
            options=run,
        )
    console.finish("project", outcome, out, output)
