# SPDX-License-Identifier: MIT
"""Start of a stage that fills a folder of the user with copies of scans or bags."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from salsanext_cli.io.files.locks import remove_if_empty
from salsanext_cli.runs.results.manifest import StageRecord, require_same_settings, settings_json
from salsanext_cli.runs.results.owned_folder import OwnedFolder


@contextmanager
def begin(owned: OwnedFolder, settings: Any, overwrite: bool) -> Iterator[None]:
    """Open a folder that runs of a stage share, and record their settings.

    The record of the first run goes if it leaves nothing else.

    Parameters
    ----------
    owned : OwnedFolder
        New or empty folder, or one that runs of the stage filled.
    settings : dataclass
        Settings that decide the content of the folder.
    overwrite : bool
        Whether files of a run with other settings are removed first.

    Raises
    ------
    OutputError
        If the folder contains other files, or results of other settings.
    """
    with remove_if_empty(owned.root), ExitStack() as stack:
        with owned.locked_records():
            is_first = owned.manifest.record(owned.stage) is None
            _record(owned, settings, overwrite)
            if is_first:
                stack.callback(_withdraw, owned)
            stack.enter_context(owned.open(shared=True))
        yield


def _withdraw(owned: OwnedFolder) -> None:
    """Remove the record of runs that have ended without any scan or bag."""
    with owned.locked_records():
        if not owned.written() and not owned.is_shared():
            owned.remove_records([owned.record_path.name])


def foresee(owned: OwnedFolder, settings: Any, overwrite: bool) -> bool:
    """Refuse what `begin` refuses; return whether the files of the folder would stay.

    Nothing is written or locked.
    """
    record = StageRecord(stage=owned.stage, settings=settings_json(settings))
    return _outdated(owned, record, overwrite) is None


def _record(owned: OwnedFolder, settings: Any, overwrite: bool) -> None:
    """Record the settings in a new folder, or one with the same settings unless overwriting."""
    record = StageRecord(stage=owned.stage, settings=settings_json(settings))
    outdated = _outdated(owned, record, overwrite)
    if outdated is not None:
        if owned.is_shared():
            raise owned.busy()
        owned.remove_written(outdated)
    owned.manifest.write(record)


def _outdated(owned: OwnedFolder, record: StageRecord, overwrite: bool) -> list[Path] | None:
    """Return the files of other settings, which go; None if all files stay."""
    earlier = owned.manifest.record(owned.stage)
    if earlier is None:
        owned.require_new()
        return None
    if earlier.has_settings(record.settings):
        return None
    outdated = [path for path in owned.written() if path != owned.record_path]
    if outdated and not overwrite:
        require_same_settings(owned.record_path, earlier.settings, record.settings)
    return outdated
