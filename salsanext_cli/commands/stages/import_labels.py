# SPDX-License-Identifier: MIT
"""Stage `import-labels`: labels of a labelling tool to the label files of a data set."""

import hashlib
import logging
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, RawIds
from salsanext_cli.core.errors import (
    LabelError,
    NoInputError,
    OutputError,
    SalsanextError,
    UsageError,
)
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.reading import is_folder
from salsanext_cli.io.formats import FORMATS, format_of, read_scan
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.io.formats.label_scalars import LabelIds
from salsanext_cli.io.formats.recordings import recording_of
from salsanext_cli.runs.annotation.edited_files import (
    find_edited,
    has_coordinates,
    read_edited,
    scan_of_edited,
)
from salsanext_cli.runs.annotation.label_records import (
    ImportedScan,
    LabelImport,
    LabelRecords,
    labels_root,
    pre_labelled_scans,
)
from salsanext_cli.runs.annotation.map_frames import frames_beside, with_frame
from salsanext_cli.runs.loop.run_options import Progress
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import data_set_label_space, space_of

log = logging.getLogger(__name__)


def import_labels(
    edited: Path,
    dataset: Path,
    *,
    scalar: str | None = None,
    ids: Path | None = None,
    space: LabelSpace | None = None,
    sensor: Sensor | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> LabelImport:
    """Write label files of the scans of a data set from files of a labelling tool.

    Parameters
    ----------
    edited : Path
        File of one scan, or folder of such files.
    dataset : Path
        Data set of `pick`, or folder of scans.
    scalar : str, optional
        Name of the scalar with the labels; by default the only one with a usual name.
    ids : Path, optional
        YAML file that maps the ids of the tool to class names or raw ids.
    space : LabelSpace, optional
        Classes of the labels; by default those of the data set.
    sensor : Sensor, optional
        Names of the columns of scan files without names.
    overwrite : bool
        Whether to replace labels that were changed or imported from another file.
    progress : callable, optional
        Function of the number of finished scans and of all.

    Returns
    -------
    LabelImport
    """
    scans = find_scans(dataset)
    space = _space_for(scans, space, dataset)
    imported = LabelImport(space=space, class_points=np.zeros(space.class_count, np.int64))
    edited_files = _edited_files(edited, scans, imported)
    roots = sorted({labels_root(scan) for scan in edited_files})
    records = {root: LabelRecords(root) for root in roots}
    meanings = LabelIds.from_space(space, ids)
    is_named = not is_folder(edited)
    frames = frames_beside(
        scan for scan, paths in edited_files.items() if any(map(has_coordinates, paths))
    )
    with ExitStack() as locks:
        for record in records.values():
            locks.enter_context(record.owned.open())
        for done, (scan, paths) in enumerate(edited_files.items(), start=1):
            try:
                # Tools save clouds of LAS in map coordinates.
                cloud = with_frame(scan, read_scan(scan.path, sensor), frames)
                labels = {
                    path: read_edited(path, scan, cloud, meanings, space, scalar) for path in paths
                }
                record = records[labels_root(scan)]
                _import_scan(scan, labels, record, imported, overwrite=overwrite, named=is_named)
            except SalsanextError as error:
                imported.fail(paths, error)
            if progress:
                progress(done, len(edited_files))
    if imported.unedited and not imported.scans and not imported.failures:
        hint = "save the corrected labels; to accept a pre-label, name its file"
        raise NoInputError(edited, "contains only unchanged pre-labels", "edited labels", hint)
    imported.unchanged = len(scans) - len(edited_files)
    imported.pre_labelled = [scan.name for scan in pre_labelled_scans(scans)]
    return imported


def _space_for(scans: Sequence[ScanFile], space: LabelSpace | None, dataset: Path) -> LabelSpace:
    """Return the label space of an import; refuse one that contradicts the data set."""
    if recording_of(scans[0].path) is not None:
        hint = f"run `salsanext convert {dataset} FOLDER` first"
        raise NoInputError(dataset, "is a recording, which has no label files", "scans", hint)
    space_of_data_set = space_of(scans)
    if space is None:
        return space_of_data_set
    if data_set_label_space(labels_root(scans[0])) and not space.fits(space_of_data_set):
        problem = f"{space.name} differs from labels.yaml of the data set in classes or ids"
        hint = f"map the ids of the tool with {argument('ids')}, or change labels.yaml"
        raise UsageError(argument("space"), problem, space_of_data_set.name, hint)
    return space


def _edited_files(
    edited: Path, scans: Sequence[ScanFile], imported: LabelImport
) -> dict[ScanFile, list[Path]]:
    """Return the edited files by scan, in the order of the scans; other files are failures."""
    files = find_edited(edited)
    if is_folder(edited):
        files_of_data_set = {path for scan in scans for path in (scan.path, scan.label_path)}
        own_labels = [path for path in files if format_of(path.name) is FORMATS["las"]]
        files = [path for path in files if path not in files_of_data_set] or own_labels
        if not files:
            problem = "contains only the labels of the data set itself"
            raise NoInputError(edited, problem, "files of a labelling tool elsewhere")
    by_scan: dict[ScanFile, list[Path]] = {}
    for path in files:
        try:
            by_scan.setdefault(scan_of_edited(path, edited, scans), []).append(path)
        except LabelError as error:
            imported.fail([path], error)
    return {scan: by_scan[scan] for scan in scans if scan in by_scan}


def _import_scan(
    scan: ScanFile,
    labels: dict[Path, tuple[RawIds, ImportedScan]],
    records: LabelRecords,
    imported: LabelImport,
    *,
    overwrite: bool,
    named: bool,
) -> None:
    """Write the labels of a scan from the only file that differs from its pre-label.

    `named`: whether the user named the file, which may be an unchanged pre-label then.
    """
    contents = {path: encode_labels(raw) for path, (raw, _) in labels.items()}
    unedited = [
        path
        for path, content in contents.items()
        if records.is_pre_label(scan, hashlib.sha256(content).hexdigest())
    ]
    if named and unedited:
        log.warning("%s: contains unchanged pre-labels", unedited[0])
    elif unedited:
        imported.unedited += map(str, unedited)
        contents = {path: content for path, content in contents.items() if path not in unedited}
    if not contents:
        return
    if len(contents) > 1:
        problem = f"has {len(contents)} edited files: {first_few(list(contents))}"
        hint = "merge them in the labelling tool, or move the other files"
        raise LabelError(f"scan {scan.name}", problem, "one file", hint)
    path, content = next(iter(contents.items()))
    is_label_file = path == scan.label_path
    if not (overwrite or is_label_file or records.is_replaceable(scan, path)):
        raise _changed_labels(scan)
    raw, numbers = labels[path]
    records.write(scan, content, numbers)
    imported.scans.append(numbers)
    train = imported.space.to_train(raw, strict=False)
    imported.class_points += np.bincount(train, minlength=imported.space.class_count)


def _changed_labels(scan: ScanFile) -> OutputError:
    """Return the error of labels that are not replaced unasked."""
    problem = "was changed, not written by salsanext, or imported from another file"
    replaced = f"replace the labels with {setting('overwrite', True)}"
    hint = f"move older files or the labels away, or {replaced}"
    return OutputError(scan.label_path, problem, hint=hint)
