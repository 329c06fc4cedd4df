# SPDX-License-Identifier: MIT
"""Stage `import-labels`: labels that a tool wrote, to the label files of a data set."""

import hashlib
import logging
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.errors import (
    LabelError,
    NoInputError,
    OutputError,
    SalsanextError,
    UsageError,
    counted,
    first_few,
)
from salsanext_cli.files.reading import is_folder
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import encode_labels
from salsanext_cli.formats.label_scalars import LabelIds
from salsanext_cli.formats.recordings import recording_of
from salsanext_cli.labelling.edited_files import (
    edited_labels,
    find_edited,
    read_file_labels,
    scan_of_edited,
)
from salsanext_cli.labelling.label_records import (
    LabelImport,
    LabelRecords,
    first_guesses,
    labels_root,
)
from salsanext_cli.parallel.run_options import Progress
from salsanext_cli.results.paths import ScanFile, find_scans
from salsanext_cli.results.selection import data_set_label_space, space_of
from salsanext_cli.sensors.sensor import Sensor

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
    """Write label files of the scans of a data set from files that a labelling tool wrote.

    `ids`: YAML file that maps the tool's ids to names or raw ids.
    """
    scans = find_scans(dataset)
    if recording_of(scans[0].path) is not None:
        hint = f"run `salsanext convert {dataset} FOLDER` first"
        raise NoInputError(dataset, "a recording, which holds no labels", "scans", hint)
    own = space_of(scans)
    if space is not None and data_set_label_space(labels_root(scans[0])) and not space.fits(own):
        found_space = f"{space.name}, but the data set's labels.yaml has other classes or ids"
        hint = "map the ids of the tool with --map, or change labels.yaml"
        raise UsageError("--label-space", found_space, own.name, hint)
    space = space or own
    meanings = LabelIds.of_space(space, ids)
    imported = LabelImport(space, class_points=np.zeros(space.class_count, np.int64))
    files = find_edited(edited)
    if is_folder(edited):
        # The scans and the label files of the data set itself are in use.
        in_place = {path for scan in scans for path in (scan.path, scan.label_path)}
        files = [path for path in files if path not in in_place]
        if not files:
            text = "holds no labels but those of the data set itself, which are in use"
            raise NoInputError(edited, text, "what a tool wrote elsewhere")
    of_scan = _matched(files, edited, scans, imported)
    records = {root: LabelRecords(root) for root in sorted({*map(labels_root, of_scan)})}
    task = partial(_import_scan, imported=imported, meanings=meanings, scalar=scalar)
    task = partial(task, sensor=sensor, overwrite=overwrite, is_named=not is_folder(edited))
    with ExitStack() as held:
        for each in records.values():
            held.enter_context(each.owned.open())
        for done, (scan, paths) in enumerate(of_scan.items(), start=1):
            try:
                task(scan, paths, records[labels_root(scan)])
            except SalsanextError as error:
                imported.fail(paths, error)
            if progress:
                progress(done, len(of_scan))
    if imported.unedited and not imported.scans and not imported.failures:
        text = "holds the first guess of `pick`, which nobody has corrected"
        hint = "save the corrected labels; to take the guess as it is, name its file"
        raise NoInputError(edited, text, "edited labels", hint)
    imported.kept = len(scans) - len(of_scan)
    imported.first_guesses = [scan.name for scan in first_guesses(scans)]
    return imported


def _matched(
    files: Sequence[Path], edited: Path, scans: Sequence[ScanFile], imported: LabelImport
) -> dict[ScanFile, list[Path]]:
    """Return the files of each scan that has some; the others are failures."""
    of_scan: dict[ScanFile, list[Path]] = {}
    for path in files:
        try:
            of_scan.setdefault(scan_of_edited(path, edited, scans), []).append(path)
        except LabelError as error:
            imported.fail([path], error)
    return {scan: of_scan[scan] for scan in scans if scan in of_scan}


def _import_scan(
    scan: ScanFile,
    paths: Sequence[Path],
    records: LabelRecords,
    imported: LabelImport,
    *,
    meanings: LabelIds,
    scalar: str | None,
    sensor: Sensor | None,
    overwrite: bool,
    is_named: bool,
) -> None:
    """Write the labels of a scan, merged from those of some files that were edited."""
    points = read_scan(scan.path, sensor).points
    read = {path: read_file_labels(path, points, meanings, scalar) for path in paths}
    none, space = meanings.unlabelled, imported.space

    def is_guess(raw: RawIds) -> bool:
        return records.is_guess(scan, hashlib.sha256(encode_labels(raw)).hexdigest())

    edited = {
        path: part for path, part in read.items() if is_named or not is_guess(part[0].filled(none))
    }
    if edited:
        raw, numbers = edited_labels(scan, edited, space, none)
        if is_guess(raw):
            if is_named:
                log.warning("%s: holds the first guess, all of it", paths[0])
            else:
                # Parts of it that nobody corrected.
                edited = {}
    imported.unedited += [str(path) for path in paths if path not in edited]
    if not edited:
        return
    if contradicted := numbers.contradicted:
        text = "%s: %s left unlabelled, of different labels in %s"
        log.warning(text, scan.name, counted(contradicted, "point"), first_few([*edited]))
    in_place = [*paths] == [scan.label_path]
    if not (overwrite or in_place or records.is_replaceable(scan, paths, contradicted)):
        text = "kept: changed, not written by salsanext, imported from another file, "
        text += "or the files contradict each other"
        hint = "leave out older files, move the labels, or replace them with --overwrite"
        raise OutputError(scan.label_path, text, hint=hint)
    records.write(scan, encode_labels(raw), numbers)
    imported.scans.append(numbers)
    train = space.to_train(raw, strict=False)
    imported.class_points += np.bincount(train, minlength=space.class_count)
