# SPDX-License-Identifier: MIT
"""`salsanext report`."""

from pathlib import Path

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import names_in, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.commands.line.values.results_of_pick import results_in
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.results.query import ResultQuery


def report(
    out: Path = declarations.RESULTS,
    *,
    scans: str | None = option(
        "Scans to show in 3-D, such as 08/000000,08/000010.",
        metavar="NAMES",
        show_default="up to four notable scans",
    ),
    page: Path | None = option(
        "File to write (.html).",
        "--output",
        "-o",
        metavar="FILE",
        show_default="report.html, in the folder OUT",
    ),
    opened: bool = option("Open the page in the browser.", "--open", default=False),
    query: ResultQuery,
    running: declarations.Unsharded,
    output: console.Output,
) -> None:
    """Write a page for any browser: numbers, plots, and scans in 3-D.

    Example: salsanext report out/
    """
    from salsanext_cli.commands.stages.report import report as stage

    out = results_in(out)
    with over_results("report", running, output.quiet, at_end=True) as options:
        written = stage(
            out,
            page,
            scans=names_in(scans, "--scans", "08/000000,08/000010"),
            query=query,
            options=options,
        )
    missing = written.run.missing
    output.result(written.to_dict())
    summary.print_failures(written.failures)
    for name, reason in written.shown.items():
        output.print(f"  {name}: {reason}")
    verdict = written.verdict
    if verdict is not None:
        output.print(verdict.sentence)
    count = f"{counted(len(written.run.rows), 'scan')}{summary.text_of_other_scans(missing)}"
    megabytes = written.page.stat().st_size / 1e6
    output.print(f"report: {count} → {written.page} ({megabytes:.1f} MB)")
    if opened and typer.launch(written.page.absolute().as_uri()) != 0:
        output.print(f"report: no browser could be started; open {written.page} yourself")
    summary.exit_with_status(written.failures, missing)
