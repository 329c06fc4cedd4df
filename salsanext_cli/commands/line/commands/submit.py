# SPDX-License-Identifier: MIT
"""`salsanext submit`."""

from dataclasses import asdict
from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.console import print_line
from salsanext_cli.commands.line.output.progress import writing
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.results.query import named_label_space


def submit(
    out: Path = argument(
        "Folder with the predictions of the test split.", default=..., metavar="OUT"
    ),
    target: Path = argument("File to write (.zip).", default=..., metavar="ZIP"),
    *,
    description: Path | None = option("Text file about the method, packed as description.txt."),
    dataset: Path | None = declarations.DATASET_OF_RESULTS,
    label_space: str | None = declarations.LABEL_SPACE,
    overwrite: bool = declarations.OVERWRITE,
    output: console.Output,
) -> None:
    """Check the predictions of the test split and pack them for the benchmark of SemanticKITTI.

    Example: salsanext submit out/ submission.zip
    """
    from salsanext_cli.commands.stages.submit import submit as stage

    with writing("submit", output.quiet, unit="files", at_end=True) as on_progress:
        submission = stage(
            out,
            target,
            dataset=dataset,
            space=named_label_space(label_space),
            description=description,
            overwrite=overwrite,
            progress=on_progress,
        )
    written = str(target) if submission.is_packed else None
    output.result({"stage": "submit", **asdict(submission), "zip": written})
    for problem in submission.problems:
        print_line(f"error: {problem.text}")
    if submission.problems:
        cases = sum(len(problem.cases) for problem in submission.problems)
        kinds = counted(len(submission.problems), "kind")
        counts = f"{counted(cases, 'problem')} of {kinds}, listed in full by --json"
        output.print(f"submit: {counts}; nothing was packed")
    else:
        output.print(f"submit: {counted(submission.scans, 'scan')} → {target}")
    summary.exit_with_status(submission.problems)
