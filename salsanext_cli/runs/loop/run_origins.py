# SPDX-License-Identifier: MIT
"""Origins of the registered scans of a run: recorded ones, else by poses."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Origins
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import are_replaced, recorded_origin
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class OriginsOfRun:
    """Origins of the registered scans of a run, the same for its fit and for its results.

    Attributes
    ----------
    out : Path
        Output folder, whose recorded origins are used unless the run replaces them.
    stage : str
        Stage that runs.
    listed : sequence of ScanFile
        All scans of the source, from which a few show whether the poses of a sequence are used.
    overwrite : bool
        Whether the run replaces existing results.
    """

    out: Path
    stage: str
    listed: Sequence[ScanFile]
    overwrite: bool = False

    def sample_origins(self, files: Sequence[ScanFile], sensor: Sensor) -> Origins:
        """Return the origins, in metres, of scans that a fit reads; points show the others."""
        recorded: Origins = {}
        if not are_replaced(self.out, self.stage, overwrite=self.overwrite):
            for file in files:
                with suppress(SalsanextError):  # The run reports a damaged file.
                    origin = recorded_origin(self.out, file, sensor)
                    if origin is not None:
                        recorded[file.name] = origin
        others = [file for file in files if file.name not in recorded]
        by_poses, _ = _by_poses(others, sensor, self.listed)
        return recorded | by_poses

    def result_origins(
        self, output: OutputRun, files: Sequence[ScanFile], sensor: Sensor
    ) -> Origins:
        """Return the origins by poses of the scans of a run that are to do and have no record.

        The log has a line about the poses of each of their sequences.
        """
        todo = [file for file in files if not output.is_done(file)]
        if not are_replaced(self.out, self.stage, overwrite=self.overwrite):
            todo = [file for file in todo if not _is_recorded(self.out, file, sensor)]
        by_poses, lines = _by_poses(todo, sensor, self.listed)
        for line in lines:
            log.log(NOTICE, "%s", line)
        return by_poses


@dataclass(frozen=True, slots=True, kw_only=True)
class OriginsOfSource:
    """Origins of the registered scans of a source, for a stage that records none.

    Attributes
    ----------
    listed : sequence of ScanFile
        All scans of the source, from which a few show whether the poses of a sequence are used.
    """

    listed: Sequence[ScanFile]

    def sample_origins(self, files: Sequence[ScanFile], sensor: Sensor) -> Origins:
        """Return the origins, in metres, of scans that a fit reads; points show the others."""
        return _by_poses(files, sensor, self.listed)[0]

    def scan_origins(self, files: Sequence[ScanFile], sensor: Sensor) -> Origins:
        """Return the origins of scans that a stage works on, and log which poses are used."""
        by_poses, lines = _by_poses(files, sensor, self.listed)
        for line in lines:
            log.log(NOTICE, "%s", line)
        return by_poses


def _by_poses(
    files: Sequence[ScanFile], sensor: Sensor, listed: Sequence[ScanFile]
) -> tuple[Origins, list[str]]:
    """Return the origins of scans by poses, and lines about the poses."""
    if not (files and sensor.has_registered):
        return {}, []
    # Labels of scans that are not registered need nothing of `fusion`.
    from salsanext_cli.runs.fit.pose_origins import origins_by_poses

    by_poses = origins_by_poses(files, sensor, listed)
    return by_poses.origins, by_poses.lines


def _is_recorded(out: Path, file: ScanFile, sensor: Sensor) -> bool:
    """Return whether there is a record of the origin of a scan, which may be damaged."""
    try:
        return recorded_origin(out, file, sensor) is not None
    except SalsanextError:
        return True
