# SPDX-License-Identifier: MIT
"""`salsanext view`."""

import os
import shlex
from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.interruption import ARRIVED
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.commands.line.values.results_of_pick import results_in
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.results.query import ResultQuery


def view(
    out: Path = declarations.RESULTS,
    *,
    port: int = option("Port on this machine; 0: any free port.", default=8765, min=0, max=65535),
    query: ResultQuery,
    running: declarations.ReadOnlyRunOptions,
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
        ARRIVED.clear()  # Ctrl-C is the usual end of this command, and no interruption.
        output.print("view: ended")
    summary.exit_with_status(server.failures, server.missing)


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
