# SPDX-License-Identifier: MIT
"""Labels beside scans whose ids are those of another label space than the results."""

import logging
from collections.abc import Sequence
from contextlib import suppress

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError, SalsanextError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import with_hint
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import evenly_spaced

log = logging.getLogger(__name__)

SAMPLE = 4
"""Label files that are read: one alone may be wrong, and then only its scan fails."""


def warn_of_foreign_labels(
    scans: Sequence[ScanFile], space: LabelSpace, sensor: Sensor | None
) -> bool:
    """Return whether the labels of scans have the ids of another label space, and warn if so.

    Parameters
    ----------
    scans : sequence of ScanFile
        Scans, of which some may have labels.
    space : LabelSpace
        Label space that the labels are supposed to have.
    sensor : Sensor or None
        Sensor of the scans, whose columns headerless files have.

    Returns
    -------
    bool
        Whether no sampled label file can be mapped. The scans can be shown without truth.
    """
    labelled = [scan for scan in scans if present(scan.label_path)]
    sample = evenly_spaced(labelled, SAMPLE)
    errors = [error for scan in sample if (error := _error_of(scan, space, sensor))]
    if not errors or len(errors) < len(sample):
        return False
    first = errors[0]
    log.warning("%s", with_hint(f"{first.headline}; shown without true labels", first.hint))
    return True


def _error_of(scan: ScanFile, space: LabelSpace, sensor: Sensor | None) -> LabelError | None:
    """Return the error of the ids in the labels of a scan, None without one.

    A file that cannot be read has none: its scan fails by itself.
    """
    with suppress(SalsanextError):
        count = len(read_scan(scan.path, sensor))
        labels = read_labels(scan.label_path, count)
        try:
            space.to_train(labels, strict=False, source=scan.label_path)
        except LabelError as error:
            return error
    return None
