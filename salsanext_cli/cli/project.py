# SPDX-License-Identifier: MIT
"""`salsanext project`."""

from pathlib import Path
from typing import Annotated

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


def project(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    dataset: options.DataSet = None,
    selection: ScanSelection,
    topic: options.Topic = None,
    network: Annotated[
        options.NetworkOptions, Without({"device", "precision", "engine", "intensity"})
    ],
    running: RunOptions,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Project scans onto range images and write these, for `predict` or your own programs.

    Example: salsanext project seq/velodyne out/
    """
    from salsanext_cli.stages.project import project_scans

    with over_scans("project", running, output.quiet) as run:
        outcome = project_scans(
            options.source(scans, dataset, topic),
            out,
            sensor=network.named_sensor() or network.trained_sensor(),
            fit=network.is_fitted,
            selection=selection,
            options=run,
        )
    sensor = None if network.sensor == options.AUTO else network.sensor
    named = {"--weights": network.weights, "--sensor": sensor}
    more = [word for name, value in named.items() if value for word in (name, str(value))]
    run_end.finish("project", outcome, out, output, *more, strict=strict)
