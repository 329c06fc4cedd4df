# SPDX-License-Identifier: MIT
"""Events of a run over scans: a file that gets a line of JSON for each scan that has ended."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.core.errors import OutputError, SalsanextError
from salsanext_cli.core.texts import escaped

if TYPE_CHECKING:
    from collections.abc import Callable

    from salsanext_cli.runs.scans.scan_file import ScanFile

EVENT_SCHEMA = 1
"""Version of the lines; it grows when a key changes or goes."""
MAX_LINE_BYTES = 1 << 16  # A first line that is longer is no event


@dataclass(frozen=True, slots=True, kw_only=True)
class EventFile:
    """File that a run appends its events to.

    Attributes
    ----------
    path : Path
        The file. It may be missing, contain events of earlier runs, or be a pipe.
    command : str
        Command of the run, which each line names.

    Raises
    ------
    OutputError
        If it contains anything but events.
    """

    path: Path
    command: str = ""

    def __post_init__(self) -> None:
        self._begins_a_line()

    @contextmanager
    def opened(self, total: int) -> Iterator["EventLog"]:
        """Open the file for a run over `total` scans."""
        from salsanext_cli.io.files.atomic import appending

        begins_a_line = self._begins_a_line()
        with appending(self.path) as append:
            if not begins_a_line:
                append(b"\n")
            yield EventLog(command=self.command, total=total, append=append)

    def _begins_a_line(self) -> bool:
        """Return whether the next byte begins a line; refuse a file of anything but events."""
        from salsanext_cli.io.files.reading import reading

        if not self.path.is_file():
            return True  # A folder is refused when it is opened
        with reading(self.path) as file:
            first = file.readline(MAX_LINE_BYTES)
            if not first:
                return True
            if not _is_event(first):
                hint = "use another name; events are appended only to a file of events"
                raise OutputError(self.path, "is no file of events", "a new file", hint)
            file.seek(-1, 2)
            return file.read(1) == b"\n"


def _is_event(line: bytes) -> bool:
    """Return whether a line is one that an `EventLog` wrote."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return isinstance(event, dict) and {"schema", "scan", "state"} <= event.keys()


@dataclass(slots=True, kw_only=True)
class EventLog:
    """Lines of one run.

    Attributes
    ----------
    command : str
        Command of the run.
    total : int
        Number of its scans.
    append : callable, optional
        Function that appends bytes to the file; None without a file.
    count : int
        Number of scans that have ended.
    """

    command: str = ""
    total: int = 0
    append: "Callable[[bytes], None] | None" = None
    count: int = 0

    def add(
        self, scan: "ScanFile", error: SalsanextError | None = None, warnings: Sequence[str] = ()
    ) -> None:
        """Append the line of a scan that has ended.

        Parameters
        ----------
        scan : ScanFile
            The scan.
        error : SalsanextError, optional
            Why it failed.
        warnings : sequence of str
            Codes of the warnings about it.
        """
        self.count += 1
        values: dict[str, object] = {
            "scan": str(scan.path),
            "name": scan.name,
            "state": "failed" if error else "done",
            "warnings": list(warnings),
        }
        if error:
            values |= {"reason": error.headline, "hint": error.hint, "code": error.code}
        self._write(values)

    def add_nothing(self) -> None:
        """Append the line of a run without scans to work on, so that a reader does not wait."""
        self._write({"scan": None, "name": None, "state": "none", "warnings": []})

    def _write(self, values: Mapping[str, object]) -> None:
        """Append a line with the time, the run and values of its own."""
        if self.append is None:
            return
        event = {
            "schema": EVENT_SCHEMA,
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "command": self.command,
            "count": self.count,
            "total": self.total,
            **values,
        }
        self.append(f"{json.dumps(escaped(event))}\n".encode())

    @contextmanager
    def together(self, scans: Sequence["ScanFile"]) -> Iterator[None]:
        """Append the lines of scans that end together with the body, all with its error."""
        try:
            yield
        except SalsanextError as error:
            self._add_all(scans, error)
            raise
        self._add_all(scans, None)

    def _add_all(self, scans: Sequence["ScanFile"], error: SalsanextError | None) -> None:
        for scan in scans:
            self.add(scan, error)


@contextmanager
def opened_events(file: EventFile | None, total: int) -> Iterator[EventLog]:
    """Open the events of a run over `total` scans; without a file, they go nowhere.

    A run without scans appends a line that states so.
    """
    if file is None:
        yield EventLog()
        return
    with file.opened(total) as events:
        if not total:
            events.add_nothing()
        yield events
