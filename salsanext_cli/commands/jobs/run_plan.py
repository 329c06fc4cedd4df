# SPDX-License-Identifier: MIT
"""Plan of a run that computes results by a network: its scans, their sensor, and the size."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.sensors.sensor import NOISE, Sensor
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.paths import ORIGINS, ScanFile

NPY_HEADER_BYTES = 128


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlan:
    """What a run would do.

    Attributes
    ----------
    scans, done, todo : int
        Number of scans of the source; of selected scans of the shard with and without results.
    points_per_scan : int
        Mean number of points of up to 16 scans, evenly spaced; 0 if none can be read.
    bytes_per_scan : int
        Estimated size of the results of a scan, without those of ``objects`` and ``votes``.
    sensor, trained : Sensor
        Sensor of the run, and that of the weights.
    """

    scans: int
    done: int
    todo: int
    points_per_scan: int
    bytes_per_scan: int
    sensor: Sensor
    trained: Sensor

    @classmethod
    def from_run(
        cls,
        run: OutputRun,
        network: Network,
        *,
        listed: Sequence[ScanFile],
        scans: Sequence[ScanFile],
        scans_of_shard: Sequence[ScanFile],
        folders: Iterable[str],
    ) -> "RunPlan":
        """Return the plan of a run.

        Parameters
        ----------
        run : OutputRun
            Run that would begin, as of `foreseen_run`.
        network : Network
            Network, fitted to the scans.
        listed, scans, scans_of_shard : sequence of ScanFile
            All scans of the source, those that were selected, and those of the shard.
        folders : iterable of str
            Folders of the results.
        """
        sample = sample_of_files(scans, network.sensor).scans
        points = round(np.mean([len(scan) for scan in sample])) if sample else 0
        todo = sum(1 for scan in scans_of_shard if not run.is_done(scan))
        return cls(
            scans=len(listed),
            done=len(scans_of_shard) - todo,
            todo=todo,
            points_per_scan=points,
            bytes_per_scan=sum(_result_bytes(folder, points, network) for folder in folders),
            sensor=network.sensor,
            trained=network.card.sensor,
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {
            "dry_run": True,
            "found": self.scans,
            "complete": self.done,
            "todo": self.todo,
            "points_per_scan": self.points_per_scan,
            "bytes": self.todo * self.bytes_per_scan,
            "sensor": self.sensor.to_dict(NOISE),
        }


def _result_bytes(folder: str, points: int, network: Network) -> int:
    """Return the size of the result of a scan with so many points, in bytes; 0 if unknown."""
    shape = network.sensor
    if folder.startswith("uncertainty/"):
        return NPY_HEADER_BYTES + 4 * points
    sizes = {
        "predictions": 4 * points,
        "probabilities": NPY_HEADER_BYTES + 2 * points * network.space.class_count,
        "pixel_labels": NPY_HEADER_BYTES + shape.height * shape.width,
        ORIGINS: NPY_HEADER_BYTES + 24,
    }
    return sizes.get(folder, 0)
