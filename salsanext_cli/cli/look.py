# SPDX-License-Identifier: MIT
"""Commands of the panel Look: pictures and pages of results."""

import os
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import arguments, console, summary
from salsanext_cli.cli.console import over_scans, progress, tell
from salsanext_cli.cli.expansion import Without
from salsanext_cli.cli.interruption import ARRIVED
from salsanext_cli.errors import counted
from salsanext_cli.option_fields import names_in, option_group, own_option
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import ResultQuery, named_label_space
from salsanext_cli.results.uncertainty_kinds import COLOUR_HELP


@option_group
class PictureOptions:
    """Colours of `picture`."""

    colour: list[str] | None = own_option(
        f"{COLOUR_HELP}; may be given several times.",
        *("--colour", "--color"),
        show_default="everything known",
    )
    scale: tuple[float, float] | None = own_option(
        "Values at the two ends of the colour map, for a single --colour.",
        show_default="range of most values; fixed for error",
    )


def picture(
    *,
    results: arguments.Results,
    pictures: PictureOptions,
    query: ResultQuery,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Draw scans and their results, from above and as range images, as PNG.

    Example: salsanext picture --colour label --colour uncertainty
    """
    from salsanext_cli.stages.picture import picture as stage

    out = results.folder()
    with over_scans("picture", running, output.quiet) as run:
        outcome = stage(
            out,
            colours=pictures.colour or (),
            scale=pictures.scale,
            query=query,
            options=run,
        )
    summary.finish("picture", outcome, out, output)


def demo(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder for the data and the results.")
    ] = Path("demo"),
    *,
    scans: Annotated[int, typer.Option(help="Number of scans of the synthetic drive.")] = 4,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 8,
    classes: arguments.MergedInto = None,
    settings: Annotated[arguments.Network, Without({"sensor", "columns", "min_range", "ego"})],
    jobs: arguments.Jobs = 1,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Run the whole pipeline on a synthetic drive and list what to look at.

    Example: salsanext demo demo/
    """
    from salsanext_cli.report.tables import score_table
    from salsanext_cli.stages.demo import demo as stage

    made = stage(
        folder,
        scans=scans,
        samples=samples,
        settings=replace(settings, classes=named_label_space(classes)),
        options=RunOptions(jobs=jobs, overwrite=overwrite),
        bars=lambda step: progress(step, output.quiet),
    )
    pictures, out = [str(path) for path in made.pictures], folder / "out"
    result = made.evaluation.to_dict() | {"stage": "demo", "pictures": pictures}
    result["page"] = str(made.page)
    output.result(result, score_table(made.evaluation.scores))
    failures = (*made.failures, *made.evaluation.failures)
    summary.name_failures(failures)
    output.say(f"scans: {folder / 'data'}; results of every stage: {out}/sequences/00")
    output.say(f"clouds, for CloudCompare, MeshLab or open3d: {out}/sequences/00/ply/*.ply")
    output.say(f"everything on one page, for any browser: {made.page}")
    summary.leave(failures, made.evaluation.missing)


def report(
    *,
    results: arguments.Results,
    scans: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Scans to show point by point, such as 08/000000,08/000010.",
            show_default="up to four that are worth looking at",
        ),
    ] = None,
    by_distance: arguments.ByDistance = False,
    query: ResultQuery,
    running: arguments.Reading,
    output: console.Output,
) -> None:
    """Write one page of a run that opens in any browser: numbers, plots, and scans in 3-D.

    Example: salsanext report out/
    """
    from salsanext_cli.stages.report import report as stage

    with over_scans("report", running, output.quiet) as run:
        made = stage(
            results.folder(),
            scans=names_in(scans, "--scans", "08/000000,08/000010"),
            query=query,
            by_distance=by_distance,
            options=run,
        )
    missing = made.run.missing
    output.result(made.to_dict())
    summary.name_failures(made.failures)
    for reason in made.unmapped:
        tell(f"error: {reason}")
    for name, reason in made.shown.items():
        output.say(f"  {name}: {reason}")
    scans = f"{counted(len(made.run.rows), 'scan')}{summary.left_out(missing)}"
    output.say(f"report: {scans} → {made.page} ({made.page.stat().st_size / 1e6:.1f} MB)")
    summary.leave(made.failures, missing, failed=bool(made.unmapped))


def view(
    *,
    results: arguments.Results,
    port: Annotated[
        int, typer.Option(help="Port on this machine; 0: any free one.", min=0, max=65535)
    ] = 8765,
    by_distance: arguments.ByDistance = False,
    query: ResultQuery,
    running: arguments.Reading,
    output: console.Output,
) -> None:
    """Show all scans of a run in the browser, until Ctrl-C.

    Example: salsanext view out/
    """
    from salsanext_cli.stages.report import view as stage

    with over_scans("view", running, output.quiet) as run:
        server = stage(
            results.folder(), port=port, query=query, by_distance=by_distance, options=run
        )
    summary.name_failures(server.failures)
    scans, left_out = counted(server.scans, "scan"), summary.left_out(server.missing)
    output.say(f"view: {scans}{left_out}, until Ctrl-C at")
    if forwarding := _forwarding(server.server_port, os.environ.get("SSH_CONNECTION", "")):
        output.say(f"from the machine that you sit at, first: {forwarding}")
    try:
        with server:
            output.result(server.to_dict(), server.url)
            server.serve_forever()
    except KeyboardInterrupt:
        ARRIVED.clear()
        output.say("view: ended")
    summary.leave(server.failures, server.missing)


def _forwarding(port: int, connection: str) -> str:
    """Return the command that forwards a port to where SSH_CONNECTION comes from, if to any."""
    match connection.split():
        case [_, _, host, ssh_port]:
            user = f"{name}@" if (name := os.environ.get("USER")) else ""
            other_port = ["-p", ssh_port] if ssh_port != "22" else []
            forwarded = f"{port}:127.0.0.1:{port}"
            return shlex.join(["ssh", "-N", "-L", forwarded, *other_port, user + host])
    return ""
