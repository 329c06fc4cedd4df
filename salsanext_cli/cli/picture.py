# SPDX-License-Identifier: MIT
"""`salsanext picture`."""

from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


def picture(
    *,
    results: options.Results,
    colour: Annotated[
        list[str] | None,
        typer.Option(
            "--colour",
            "--color",
            help="label, truth, wrong, intensity, range, uncertainty, or one kind of it: "
            "error, epistemic, aleatoric, total, entropy, mutual_information; may be given "
            "several times.",
            show_default="everything known",
        ),
    ] = None,
    scale: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Values at the two ends of the colour map, for a single --colour.",
            show_default="range of most of the values",
        ),
    ] = None,
    gif: Annotated[bool, typer.Option("--gif", help="Animate each sequence as GIF.")] = False,
    mp4: Annotated[
        bool, typer.Option("--mp4", help="Animate each sequence as MP4; needs ffmpeg.")
    ] = False,
    fps: Annotated[float, typer.Option(help="Scans per second of the animations.")] = 5.0,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Draw scans and their results, from above and as range images, as PNG, GIF or MP4.

    Example: salsanext picture --colour label --colour uncertainty
    """
    from salsanext_cli.stages.picture import picture as stage

    out = results.folder()
    with over_scans("picture", running, output.quiet) as run:
        outcome = stage(
            out,
            colours=colour or (),
            scale=scale,
            animations=[form for form, wanted in (("gif", gif), ("mp4", mp4)) if wanted],
            frames_per_second=fps,
            dataset=dataset,
            space=options.label_space(label_space),
            classes=options.label_space(classes),
            selection=selection,
            options=run,
        )
    run_end.finish("picture", outcome, out, output)
