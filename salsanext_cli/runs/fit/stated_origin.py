# SPDX-License-Identifier: MIT
"""Position of the sensor that the user states in the coordinates of the files."""

import logging
from collections.abc import Sequence

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.sensor_place import ORIGIN_DIGITS
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


def origin_in_frame(origin: Origin, files: Sequence[ScanFile], sensor: Sensor) -> Origin:
    """Return a stated position in the local frame of scans.

    Parameters
    ----------
    origin : 3 floats
        Position of the sensor in the coordinates of the files, in metres.
    files : sequence of ScanFile
        Scans, of which a sample is read.
    sensor : Sensor
        Sensor that names the columns of the files.

    Returns
    -------
    3 floats
        In metres.

    Raises
    ------
    UsageError
        If the scans have several local frames.
    """
    if len(files) > 1:
        message = "%s is the position of the sensor in all %s"
        log.log(NOTICE, message, argument("origin"), counted(len(files), "scan"))
    frames = {scan.notes.frame for scan in sample_of_files(files, sensor).scans}
    if len(frames) > 1:
        problem = f"was given for scans in {counted(len(frames), 'local frame')}"
        hint = "label the scans of each position by themselves"
        raise UsageError(argument("origin"), problem, "scans from one position", hint)
    if not frames:
        return origin  # No scan can be read; the run reports the errors.
    shifted = zip(origin, frames.pop(), strict=True)
    return tuple(round(value - shift, ORIGIN_DIGITS) for value, shift in shifted)
