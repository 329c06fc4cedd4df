# SPDX-License-Identifier: MIT
"""Task of `fuse`: the labels of a scan by the votes of all scans around it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.window import FusionWindow
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.drives.poses_of_sequence import points_of_drive
from salsanext_cli.runs.drives.stored_softmax import stored_softmax
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.paths import DISAGREEMENT, ScanFile, output_path
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseTask:
    """Task of `run_over_scans` that fuses the scans of drives, one drive after the other."""

    members: Mapping[str, Sequence[ScanFile]]  # Scans with a softmax in order, by sequence
    drives: Mapping[str, Drive | SalsanextError]  # By sequence
    space: LabelSpace
    sensor: Sensor
    reach: FusionReach
    single: OutputRun  # Receives the votes against the labels of single scans
    fused: OutputRun  # Receives the fused labels
    max_chunk_scans: int = 400  # Neighbours share the contents of files.

    def open(self) -> Callable[[ScanFile], ScanSummary]:
        """Return the function of a scan; its window moves from one scan to the next."""
        window_of = lru_cache(maxsize=1)(self._window)
        numbers: dict[ScanFile, int] = {}
        for files in self.members.values():
            numbers |= {file: number for number, file in enumerate(files)}
        return lambda file: self._fuse(file, numbers[file], window_of(file.sequence))

    def _window(self, sequence: str) -> FusionWindow:
        """Return the window of a sequence, which reads scans by their number."""
        drive = self.drives[sequence]
        if isinstance(drive, SalsanextError):
            raise drive
        files = self.members[sequence]

        def read(number: int) -> tuple[Float, Float]:
            origin_of = recorded_origins(self.single.root, self.sensor)
            points = points_of_drive(files[number], self.sensor, origin_of)
            softmax = stored_softmax(self.single.root, files[number], len(points), self.space)
            return points, softmax

        return FusionWindow(drive, read, self.reach, self.space.movable)

    def _fuse(self, file: ScanFile, number: int, window: FusionWindow) -> ScanSummary:
        """Fuse the labels of a scan, and write them with the disagreement."""
        self.single.require_replaceable(file)
        self.fused.require_replaceable(file)
        tally = window.tally(number)
        labels = self._labels_of_single_scan(file, len(tally.views))
        fused_labels = tally.fused(labels)
        self.single.write_array(file, DISAGREEMENT, tally.disagreement(labels))
        self.single.write_array(file, "views", tally.views)
        self.fused.write_array(file, DISAGREEMENT, tally.disagreement(fused_labels))
        self.fused.write_array(file, "views", tally.views)
        self.fused.write_labels(file, self.space.to_raw(fused_labels))
        return ScanSummary.from_labels(file, fused_labels, self.space)

    def _labels_of_single_scan(self, file: ScanFile, count: int) -> TrainIds:
        """Read the predicted train ids of the points of a scan, (count,) uint8."""
        path = output_path(self.single.root, file.sequence, "predictions", file.stem)
        return self.space.to_train(read_labels(path, count), source=path)
