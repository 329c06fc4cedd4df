# SPDX-License-Identifier: MIT
"""Paths that a command is given: the sources of its scans, and OUT."""

from dataclasses import dataclass
from pathlib import Path

import typer

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.core.texts import with_hint

EXPECTED_SCANS = "scan file, folder of scans, sequence folder, data set, recording or @list.txt"


def scan_source(scans: Path | None, dataset: Path | None, topic: str | None) -> Path:
    """Return the source of the scans: SCANS, or the data set or sequence in the current folder."""
    is_here = any(Path(name).is_dir() for name in ("sequences", "velodyne"))
    if scans is None and dataset is None and not is_here:
        problem = "not given, and the current folder is neither a data set nor a sequence"
        raise UsageError("SCANS", problem, EXPECTED_SCANS, "give . for the scans in this folder")
    return in_topic(scans or dataset or Path(), topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScansAndOut:
    """Where a command reads its scans, and where it writes its results."""

    scans: Path | list[Path]  # One source, or several
    out: Path


def scans_and_out(
    context: typer.Context, scans: Path | None, out: Path, dataset: Path | None, topic: str | None
) -> ScansAndOut:
    """Return the sources of the scans, and OUT, which is the last argument of several.

    Parameters
    ----------
    context : typer.Context
        Its `args` are the paths after the second.
    scans : Path, optional
        First path that was typed.
    out : Path
        Second path that was typed, else the default of OUT.
    dataset : Path, optional
        Value of ``--dataset``.
    topic : str, optional
        Value of ``--topic``.

    Raises
    ------
    UsageError
        If there are no scans, or OUT is a file.
    OutputError
        If the results would hide scans that lie in OUT.
    """
    from salsanext_cli.runs.scans.scan_search import require_no_hidden_scans

    paths = _typed_paths(context, scans, out)
    sources = paths[:-1]
    out = paths[-1]
    _require_folder(out)
    if len(sources) > 1:
        if topic is not None:
            raise UsageError("--topic", f"{len(sources)} sources were given", "one recording")
        require_no_hidden_scans(out)
        return ScansAndOut(scans=sources, out=out)
    single = scan_source(scans, dataset, topic)
    if scans is not None:
        # Without SCANS, no OUT was typed that could be a wrong one.
        if _is_apart(out, single):
            require_no_hidden_scans(out)
        _notice_shared_folder(single, out)
    return ScansAndOut(scans=single, out=out)


def _typed_paths(context: typer.Context, scans: Path | None, out: Path) -> list[Path]:
    """Return all paths that were typed, in their order; the last one is OUT."""
    # Typer fills SCANS and OUT with the first two; the rest is in `context.args`.
    first = [] if scans is None else [scans]
    return [*first, out, *map(Path, context.args)]


def _require_folder(out: Path) -> None:
    """Refuse a file, or a list of scans, as OUT."""
    from salsanext_cli.io.files.reading import is_folder, present
    from salsanext_cli.runs.scans.scan_list import list_of

    file_of_list = list_of(out)
    if file_of_list is not None and present(file_of_list):
        hint = f"give OUT last: salsanext predict {out} out/"
        raise UsageError("OUT", f"{out} is a list of scans", "a folder for the results", hint)
    if present(out) and not is_folder(out):
        hint = "give OUT last: salsanext predict a.bin b.bin out/"
        raise UsageError("OUT", f"{out} is a file", "a folder for the results", hint)


def _is_apart(out: Path, source: Path) -> bool:
    """Return whether results and scans are in different folders, neither inside the other."""
    # This needs no access to the disk, which may be slow.
    if out in (source, *source.parents):
        return False
    out_folder = out.resolve()
    source_folder = source.resolve()
    in_source = out_folder.is_relative_to(source_folder)
    return not in_source and not source_folder.is_relative_to(out_folder)


def _notice_shared_folder(source: Path, out: Path) -> None:
    """Print a notice if the results are written into the folder of the scans."""
    from salsanext_cli.io.files.reading import is_folder
    from salsanext_cli.runs.fit.range_images import projected_sensor

    out_folder = out.resolve()
    source_folder = source.resolve()
    problem = ""
    if out_folder == source_folder:
        if projected_sensor(source) is None:
            problem = "is given as SCANS and as OUT, so the results go into the folder of the scans"
    elif out_folder.is_relative_to(source_folder) and not is_folder(source / "sequences"):
        problem = "is inside the folder of the scans"
    if problem:
        hint = "give another folder as OUT to separate scans and results"
        log_once(with_hint(f"{out}: {problem}", hint), NOTICE)


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, or of the recording itself."""
    if topic is None:
        return source
    from salsanext_cli.io.formats.recordings import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is not a recording", "a recording as SCANS")
    return source / topic.strip("/")
