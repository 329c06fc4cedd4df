# SPDX-License-Identifier: MIT
"""`salsanext view`."""

import os
import shlex
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.errors import counted
from salsanext_cli.interruption import ARRIVED
from salsanext_cli.options import ScanSelection


def view(
    *,
    results: options.Results,
    port: Annotated[
        int, typer.Option(help="Port on this machine; 0: any free one.", min=0, max=65535)
    ] = 8765,
    by_distance: options.ByDistance = False,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: options.Reading,
    output: console.Output,
) -> None:
    """Show all scans of a run in the browser, until Ctrl-C.

    Example: salsanext view out/
    """
    from salsanext_cli.stages.view import view as stage

    with over_scans("view", running, output.quiet) as run:
        server = stage(
            results.folder(),
            port=port,
            dataset=dataset,
            space=options.label_space(label_space),
            classes=options.label_space(classes),
            by_distance=by_distance,
            selection=selection,
            options=run,
        )
    run_end.name_failures(server.failures)
    scans, left_out = counted(server.scans, "scan"), run_end.left_out(server.missing)
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
    run_end.leave(server.failures, server.missing)


def _forwarding(port: int, connection: str) -> str:
    """Return the command that brings a port of this machine to where an SSH session comes from.

    `connection` is the environment variable SSH_CONNECTION: client, its port, server, its port.
    """
    match connection.split():
        case [_, _, host, ssh_port]:
            user = f"{name}@" if (name := os.environ.get("USER")) else ""
            other_port = ["-p", ssh_port] if ssh_port != "22" else []
            forwarded = f"{port}:127.0.0.1:{port}"
            return shlex.join(["ssh", "-N", "-L", forwarded, *other_port, user + host])
    return ""
