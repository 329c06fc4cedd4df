# SPDX-License-Identifier: MIT
"""Value of `--events`: the file that gets a line for each scan."""

from pathlib import Path

from salsanext_cli.core.errors import UsageError
from salsanext_cli.runs.loop.event_file import EventFile

OPTION = "--events"


def typed_events(text: str | None) -> EventFile | None:
    """Return the file of a path; None without one."""
    if text is None:
        return None
    if not text:
        raise UsageError(OPTION, "names no file", hint=f"for example {OPTION} events.jsonl")
    return EventFile(path=Path(text))
