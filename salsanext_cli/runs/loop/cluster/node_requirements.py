# SPDX-License-Identifier: MIT
"""What a run needs of each node, as the main process finds it.

A folder has a probe: a file of random content, by which a node shows that it sees the same folder.
"""

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import packages_distributions
from pathlib import Path
from uuid import uuid4

from salsanext_cli.core.engines.registry import library_packages
from salsanext_cli.core.plug_ins import plug_in_packages
from salsanext_cli.runs.loop.cluster.node_code import (
    NodeRequirements,
    Probe,
    ReadableFile,
    SharedFolder,
    installed_versions,
)
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.scans.scan_file import ScanFile

PROBE_BYTES = 16
RENEWAL_INTERVAL_S = 3600.0


@contextmanager
def node_requirements(
    scans: Sequence[ScanFile], folders: RunFolders, arithmetic: str = ""
) -> Iterator[NodeRequirements]:
    """Write the probes of a run, which are removed at the end of the body.

    Parameters
    ----------
    scans : sequence of ScanFile
        Scans to attempt, at least one.
    folders : RunFolders
        Folders that all nodes must share.
    arithmetic : str
        How all nodes must compute int8, as `NodeRequirements` has it.

    Yields
    ------
    NodeRequirements
        Versions, modules, the first scan, the folders, and how int8 is computed.
    """
    written = {existing(folder) for folder in folders.writes}
    read = {existing(folder) for folder in folders.reads}
    with ExitStack() as probes:
        shared = [
            SharedFolder(
                path=str(folder),
                probe=probes.enter_context(probe_of(folder)),
                is_written=folder in written,
            )
            for folder in sorted(written | read)
        ]
        yield NodeRequirements(
            versions=installed_versions([*library_packages(), *plug_in_packages()]),
            files=(_readable(existing(scans[0].path)),),
            folders=tuple(shared),
            int8_arithmetic=arithmetic,
            modules=frozenset(packages_distributions()),
        )


@contextmanager
def probe_of(folder: Path) -> Iterator[Probe | None]:
    """Write a probe into a folder until the end of the body.

    Of a folder that is read-only, the first record of a stage is the probe; None without any.
    """
    content = os.urandom(PROBE_BYTES)
    # If this process is killed, a later run removes the file, as it does unfinished ones.
    path = folder / f".{uuid4().hex}.part"
    try:
        try:
            path.write_bytes(content)
        except OSError:
            yield _record_of(folder)
            return
        with _kept_recent(path):
            yield Probe(path=str(path), content=content)
    finally:
        with suppress(OSError):
            path.unlink()


@contextmanager
def _kept_recent(path: Path) -> Iterator[None]:
    """Renew the time of a file during the body: other runs remove unfinished files after a day."""
    ended = threading.Event()

    def renew() -> None:
        while not ended.wait(RENEWAL_INTERVAL_S):
            with suppress(OSError):
                os.utime(path)

    threading.Thread(target=renew, name="probe", daemon=True).start()
    try:
        yield
    finally:
        ended.set()


def _record_of(folder: Path) -> Probe | None:
    """Return the first record of a stage in a folder as a probe."""
    for path in sorted(folder.glob("*.json")):
        return Probe(path=str(path), content=path.read_bytes())
    return None


def existing(path: Path) -> Path:
    """Return a path, or the nearest folder above it that exists: scans of recordings are no files.

    The path becomes absolute.
    """
    path = path.absolute()
    return next(place for place in (path, *path.parents) if place.exists())


def _readable(path: Path) -> ReadableFile:
    return ReadableFile(path=str(path), size=path.stat().st_size if path.is_file() else None)
