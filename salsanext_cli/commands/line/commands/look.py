# SPDX-License-Identifier: MIT
"""Commands that show results: pages, and the demonstration."""

import os
import shlex
from pathlib import Path

import typer

from salsanext_cli.commands.line.options import arguments
from salsanext_cli.commands.line.options.option_fields import argument, names_in, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.interruption import ARRIVED
from salsanext_cli.commands.line.output.progress import over_results, progress_display
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery, named_label_space
from salsanext_cli.runs.sensor_request import AUTO


def demo(
    folder: Path = argument("Folder to write to.", default=Path("demo"), metavar="FOLDER"),
    *,
    scans: int = option("Number of scans of the simulated drive.", default=4),
    samples: int = option("Monte-Carlo passes per scan.", default=8),
    classes: str | None = arguments.CLASSES,
    device: str = arguments.DEVICE,
    jobs: int = arguments.JOBS,
    cluster: str | None = arguments.CLUSTER,
    overwrite: bool = arguments.OVERWRITE,
    output: console.Output,
) -> None:
    """Run the whole pipeline on a simulated drive and list the results.

    Example: salsanext demo demo/
    """
    from salsanext_cli.commands.stages.demo import demo as stage
    from salsanext_cli.report.tables import score_table

    space = named_label_space(classes)
    demonstration = stage(
        folder,
        scans=scans,
        samples=samples,
        settings=NetworkSettings(device=device, precision=AUTO, classes=space),
        options=RunOptions(jobs=jobs, cluster=cluster, overwrite=overwrite),
        progress_of_step=lambda step: progress_display(step, output.quiet),
    )
    evaluation = demonstration.evaluation
    page = demonstration.page
    data = evaluation.to_dict()
    data["stage"] = "demo"
    data["pictures"] = [str(picture) for picture in demonstration.pictures]
    data["page"] = str(page)
    output.result(data, score_table(evaluation.scores))
    failures = (*demonstration.failures, *evaluation.failures)
    summary.print_failures(failures)
    results = folder / "out/sequences/00"
    output.print(f"scans: {folder / 'data'}; results: {results}")
    output.print(f"point clouds for CloudCompare, MeshLab or Open3D: {results}/ply/*.ply")
    output.print(f"one page with all results, for any browser: {page}")
    summary.exit_with_status(failures, evaluation.missing)


def report(
    out: Path = arguments.RESULTS,
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
    running: arguments.Unsharded,
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


def view(
    out: Path = arguments.RESULTS,
    *,
    port: int = option("Port on this machine; 0: any free port.", default=8765, min=0, max=65535),
    query: ResultQuery,
    running: arguments.ReadOnlyRunOptions,
    output: console.Output,
) -> None:
    """Show all scans of a run in the browser, until Ctrl-C.

    Example: salsanext view out/
    """
    from salsanext_cli.commands.stages.report import view as stage

    out = results_in(out)
    with over_results("view", running, output.quiet, at_end=True) as options:
        server = stage(out, port=port, query=query, options=options)
    summary.print_failures(server.failures)
    scans = f"{counted(server.scans, 'scan')}{summary.text_of_other_scans(server.missing)}"
    output.print(f"view: {scans}, until Ctrl-C at")
    forwarding = _forwarding(server.server_port, os.environ.get("SSH_CONNECTION", ""))
    if forwarding:
        output.print(f"first forward the port, on your local machine: {forwarding}")
    try:
        with server:
            output.result(server.to_dict(), server.url)
            server.serve_forever()
    except KeyboardInterrupt:
        ARRIVED.clear()
        output.print("view: ended")
    summary.exit_with_status(server.failures, server.missing)


def results_in(folder: Path) -> Path:
    """Return a folder of results; in a data set of `pick`, that of the picked scans."""
    from salsanext_cli.io.files.reading import is_folder, present
    from salsanext_cli.runs.labelling.picked_data_set import PREDICTED
    from salsanext_cli.runs.results.layouts import PICK_RECORD

    predicted = folder / PREDICTED
    return predicted if present(folder / PICK_RECORD) and is_folder(predicted) else folder


def _forwarding(port: int, connection: str) -> str:
    """Return the command that forwards a port over SSH; empty without an SSH connection."""
    match connection.split():
        case [_, _, host, ssh_port]:
            words = ["ssh", "-N", "-L", f"{port}:127.0.0.1:{port}"]
            if ssh_port != "22":
                words += ["-p", ssh_port]
            user = os.environ.get("USER")
            words.append(f"{user}@{host}" if user else host)
            return shlex.join(words)
    return ""
