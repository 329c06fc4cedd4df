# SPDX-License-Identifier: MIT
"""Labels and votes of the scans of a drive, kept in memory."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.fusion.fuse_drive import VotingScan
from salsanext_cli.core.fusion.top_classes import top_classes
from salsanext_cli.core.labellers import Labeller, labeller_for
from salsanext_cli.core.labelling import LabelRequest
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float, Origin, Origins
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.drives.poses_of_sequence import points_of_drive
from salsanext_cli.runs.fit.pose_origins import origins_by_poses
from salsanext_cli.runs.fit.scan_reading import FileToLabel, read_to_label
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans, resolved_for
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile, drive_order
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanVotes:
    """Labels and votes of a scan.

    Attributes
    ----------
    file : ScanFile
        Its file.
    summary : ScanSummary
        Numbers of the scan, and reasons to doubt it.
    origin : tuple of float, optional
        Position by which its sensor was found, in metres; None if no scan has its own.
    labels : (N,) uint8
        Train ids of its points.
    votes : (N, 3) uint16
        Most probable classes, as of `top_classes`.
    """

    file: ScanFile
    summary: ScanSummary
    origin: Origin | None
    labels: TrainIds
    votes: npt.NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class VoteJob:
    """Job that labels the points of scans, and keeps their votes in memory."""

    network: Network
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    @property
    def labeller(self) -> Labeller:
        """Way of the scans to their labels, with the softmax."""
        return labeller_for(self.network, LabelRequest(softmax=True))

    def prepare(self, file: ScanFile) -> FileToLabel:
        """Read and check a scan."""
        return read_to_label(file, self.labeller, self.origins.get(file.name))

    def compute(self, files: Sequence[FileToLabel]) -> Sequence[Any]:
        """Compute the labels of scans."""
        return self.labeller.compute([file.scan for file in files])

    def finish(self, prepared: FileToLabel, computed: Any) -> ScanVotes:
        """Return the labels of the points with the votes."""
        scan = self.labeller.finish(prepared.scan, computed)
        return ScanVotes(
            file=prepared.file,
            summary=ScanSummary.from_scan(prepared.file, scan, self.network.space),
            origin=scan.checked.origin,
            labels=scan.labels,
            votes=top_classes(cast(Float, scan.softmax)),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveLabels:
    """Labelled scans of the sequences of a source.

    Attributes
    ----------
    network : Network
        Network that labelled them, fitted to their sensor.
    scans : dict of str to list of ScanVotes
        Scans in the order of the drive, by sequence.
    origins : dict of ScanFile to tuple of float
        Origins by which they were labelled, in metres; None for scans that have none.
    """

    network: Network
    scans: dict[str, list[ScanVotes]]
    origins: dict[ScanFile, Origin | None]

    @property
    def sensor(self) -> Sensor:
        """Sensor of the scans."""
        return self.network.sensor

    def files(self, sequence: str) -> list[ScanFile]:
        """Return the files of the scans of a sequence."""
        return [scan.file for scan in self.scans[sequence]]

    def origin_of(self, file: ScanFile) -> Origin | None:
        """Return the origin by which a scan was labelled."""
        return self.origins[file]

    def voting_scans(self, sequence: str) -> list[VotingScan]:
        """Return the scans of a sequence for the fusion, which reads their points again."""
        return [
            VotingScan(points=self._points_of(scan), labels=scan.labels, votes=scan.votes)
            for scan in self.scans[sequence]
        ]

    def _points_of(self, scan: ScanVotes) -> Callable[[], Float]:
        return partial(points_of_drive, scan.file, self.sensor, self.origin_of)


def label_in_memory(
    source: Path, files: Sequence[ScanFile], settings: NetworkSettings
) -> DriveLabels:
    """Label scans as `predict` does, without an output folder; log failures and warnings.

    Parameters
    ----------
    source : Path
        Folder of the scans, for errors.
    files : sequence of ScanFile
        Scans to label.
    settings : NetworkSettings
        Network, which is fitted to the scans.

    Returns
    -------
    DriveLabels

    Raises
    ------
    NoInputError
        If all scans fail.
    """

    def origins_of(sampled: Sequence[ScanFile], sensor: Sensor) -> Origins:
        return origins_by_poses(sampled, sensor, files).origins

    network = settings.load()
    sample = sample_of_files(files, network.sensor, origins_of=origins_of)
    network = fit_scans(settings, network, sample)
    by_poses = origins_by_poses(files, network.sensor, files)
    for line in by_poses.lines:
        log.log(NOTICE, "%s", line)
    summary = RunSummary.from_network(network, files)
    labelled: list[ScanVotes] = []

    def add(scan: ScanVotes) -> None:
        labelled.append(scan)
        summary.add(scan.summary)

    job = partial(VoteJob, origins=by_poses.origins)
    task = NetworkTask(job=job, settings=resolved_for(settings, network, files), network=network)
    outcome = run_over_scans(task, files, RunOptions(), on_result=add)
    summary.finished()
    for failure in outcome.failures:
        log.error("%s", failure.text)
    if not labelled:
        raise NoInputError(source, "no scan could be labelled", hint="see the errors above")
    scans: dict[str, list[ScanVotes]] = {}
    for scan in sorted(labelled, key=lambda scan: drive_order(scan.file)):
        scans.setdefault(scan.file.sequence, []).append(scan)
    origins = {scan.file: scan.origin for scan in labelled}
    return DriveLabels(network=network, scans=scans, origins=origins)
