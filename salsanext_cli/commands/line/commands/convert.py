# SPDX-License-Identifier: MIT
"""`salsanext convert`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import next_command
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.scans_and_out import in_topic
from salsanext_cli.io.formats.recording_kinds import RECORDING_KINDS

KINDS = ", ".join(f"{kind.noun} ({' '.join(kind.suffixes)})" for kind in RECORDING_KINDS)


def convert(
    recording: Path = argument(
        f"Recording of many scans: {KINDS}, or the folder of a ROS 2 bag.",
        default=...,
        metavar="RECORDING",
    ),
    folder: Path = declarations.NEW_DATASET,
    *,
    topic: str | None = declarations.TOPIC,
    every: int = option("Take only every Nth scan.", default=1),
    limit: int | None = option("Only the first N scans."),
    running: declarations.Unsharded,
    output: console.Output,
) -> None:
    """Write the scans of a recording as `.bin` files, in the layout of SemanticKITTI.

    Example: salsanext convert drive.bag drives/ --every 10
    """
    from salsanext_cli.commands.stages.convert import convert as stage

    source = in_topic(recording, topic)
    with over_scans("convert", running, output.quiet) as options:
        outcome = stage(source, folder, every=every, limit=limit, options=options)
    following = next_command(outcome, ["predict", folder])
    summary.print_summary_and_exit("convert", outcome, folder, output, following=following)
