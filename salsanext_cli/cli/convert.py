# SPDX-License-Identifier: MIT
"""`salsanext convert`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans


def convert(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="ROS bag (.bag, .mcap, .db3, a folder) or Ouster recording (.pcap, .osf).",
        ),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Root of the data set to write.")
    ],
    *,
    topic: options.TopicOfRecording = None,
    every: Annotated[int, typer.Option(help="Take every so many scans only.")] = 1,
    limit: Annotated[int | None, typer.Option(help="At most this number of scans.")] = None,
    running: options.Unsharded,
    output: console.Output,
) -> None:
    """Write the scans of a recording as `.bin` files, in SemanticKITTI's layout.

    Example: salsanext convert drive.bag drives/ --every 10
    """
    from salsanext_cli.stages.convert import convert as stage

    source = options.in_topic(recording, topic)
    with over_scans("convert", running, output.quiet) as run:
        outcome = stage(source, folder, every=every, limit=limit, options=run)
    run_end.finish("convert", outcome, folder, output)
