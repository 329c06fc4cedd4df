# SPDX-License-Identifier: MIT
"""Task of `fuse`: the labels of a scan by the votes of all scans around it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from salsanext_cli.runs.results.folder_names import DISAGREEMENT
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseTask:
    """Task of `run_over_scans` that fuses the scans of drives, one drive after the other."""

    members: Mapping[str, Sequence[ScanFile]]  # Scans with a softmax in order, by sequence
    drives: Mapping[str, Drive | SalsanextError]  # By sequence
    space: LabelSpace
    sensor: Sensor
    reach: FusionReach
    single_run: OutputRun  # Receives the votes against the labels of single scans
    fused_run: OutputRun  # Receives the fused labels
    max_chunk_scans: int = 400  # Neighbours share the contents of files.

    def open(self) -> "ScanFusion":
        """Return the function of a scan."""
        return ScanFusion(self)

    def window(self, sequence: str) -> FusionWindow:
        """Return the window of a sequence, which reads scans by their number.

        Raises
        ------
        SalsanextError
            That of the drive, if the sequence has none.
        """
        drive = self.drives[sequence]
        if isinstance(drive, SalsanextError):
            raise drive
        files = self.members[sequence]

        def read(number: int) -> tuple[Float, Float]:
            return self._points_and_softmax(files[number])

        return FusionWindow(drive, read, self.reach, self.space.movable)

    def _points_and_softmax(self, file: ScanFile) -> tuple[Float, Float]:
        """Return the points (N, 3) of a scan and their class probabilities (N, C)."""
        root = self.single_run.root
        points = points_of_drive(file, self.sensor, recorded_origins(root, self.sensor))
        return points, stored_softmax(root, file, len(points), self.space)

    def fuse(self, file: ScanFile, number: int, window: FusionWindow) -> ScanSummary:
        """Fuse the labels of a scan, and write them with the disagreement.

        `number`: index of the scan in its sequence; `window`: of that sequence.
        """
        self.single_run.require_replaceable(file)
        self.fused_run.require_replaceable(file)
        tally = window.tally(number)
        labels = self._labels_of_single_scan(file, len(tally.scan_counts))
        fused_labels = tally.fused(labels)
        self.single_run.write_array(file, DISAGREEMENT, tally.disagreement(labels))
        self.single_run.write_array(file, "views", tally.scan_counts)
        self.fused_run.write_array(file, DISAGREEMENT, tally.disagreement(fused_labels))
        self.fused_run.write_array(file, "views", tally.scan_counts)
        self.fused_run.write_labels(file, self.space.to_raw(fused_labels))
        return ScanSummary.from_labels(file, fused_labels, self.space)

    def _labels_of_single_scan(self, file: ScanFile, count: int) -> TrainIds:
        """Read the predicted train ids of the points of a scan, (count,) uint8."""
        path = output_path(self.single_run.root, file.sequence, "predictions", file.stem)
        return self.space.to_train(read_labels(path, count), source=path)


class ScanFusion:
    """Function of a scan, whose window moves from one scan of a drive to the next."""

    def __init__(self, task: FuseTask) -> None:
        self.task = task
        self.numbers: dict[ScanFile, int] = {}  # Index of each scan in its sequence
        for files in task.members.values():
            self.numbers |= {file: number for number, file in enumerate(files)}
        self.sequence: str | None = None  # That of the window
        self.window: FusionWindow | None = None

    def __call__(self, file: ScanFile) -> ScanSummary:
        """Fuse the labels of a scan."""
        if self.window is None or file.sequence != self.sequence:
            self.window = self.task.window(file.sequence)
            self.sequence = file.sequence
        return self.task.fuse(file, self.numbers[file], self.window)
