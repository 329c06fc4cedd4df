# SPDX-License-Identifier: MIT
"""`salsanext submit`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress, tell
from salsanext_cli.errors import counted, printable


def submit(
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder with predictions of the test split.")
    ],
    target: Annotated[Path, typer.Argument(metavar="ZIP", help="File to write (.zip).")],
    *,
    description: Annotated[
        Path | None, typer.Option(help="Text file about the method, packed as description.txt.")
    ] = None,
    dataset: options.DataSetOfResults = None,
    label_space: options.LabelSpaceName = None,
    overwrite: options.Overwrite = False,
    output: console.Output,
) -> None:
    """Check the predictions of the test split and pack them for SemanticKITTI's benchmark.

    Example: salsanext submit out/ submission.zip
    """
    from salsanext_cli.stages.submit import submit as stage

    with progress("submit", output.quiet, unit="files") as on_progress:
        made = stage(
            out,
            target,
            dataset=dataset,
            space=options.label_space(label_space),
            description=description,
            overwrite=overwrite,
            progress=on_progress,
        )
    output.result(made.to_dict() | {"zip": str(target)})
    for problem in made.problems:
        tell(f"error: {printable(problem.message)}")
    if made.problems:
        tell(f"submit: {counted(len(made.problems), 'problem')}, {target} is not written")
        raise typer.Exit(console.FAILED)
    output.say(f"submit: {counted(made.scans, 'scan')} → {target}")
