# SPDX-License-Identifier: MIT
"""Pixel labels, or anybody's point labels, to point labels by nearest neighbours."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.errors import LabelError, NoInputError, UsageError
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.npy import read_array
from salsanext_cli.formats.reading import filled, present
from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import RangeImage
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.project import read_image
from salsanext_cli.storage.layout import ScanFile, find_outputs, find_scans, output_path
from salsanext_cli.storage.output_run import claimed
from salsanext_cli.storage.point_files import write_labels
from salsanext_cli.storage.selection import ScanSelection, choose, space_of
from salsanext_cli.storage.sources import remembered_scans
from salsanext_cli.storage.stage_records import (
    origins,
    recorded_label_space,
    recorded_sensor,
)


@dataclass(frozen=True, slots=True)
class RefineScan:
    """Refine the labels of one scan."""

    out: Path
    labels: Path | None
    space: LabelSpace
    sensor: Sensor
    knn: KnnParameters

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the file that is written for a scan."""
        return [output_path(self.out, file.sequence, "predictions", file.stem)]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def __call__(self, file: ScanFile) -> None:
        """Read, refine, write."""
        image = read_image(file, self.sensor)
        if self.labels is None:
            pixel_labels = self._read_pixel_labels(file)
        else:
            path = given_labels(self.labels, file)
            raw = read_labels(path, len(image.pixel_of_point))
            pixel_labels = labels_of_pixels(image, self.space.to_train(raw, source=path))
        refined = knn_refine(image, pixel_labels, self.space.class_count, self.knn)
        write_labels(self.results_of(file)[0], self.space.to_raw(refined))

    def _read_pixel_labels(self, file: ScanFile) -> TrainIds:
        path = output_path(self.out, file.sequence, "pixel_labels", file.stem)
        labels: TrainIds = read_array(path, "uint8", (self.sensor.height, self.sensor.width))
        if labels.max() >= self.space.class_count:
            expected = f"0 … {self.space.class_count - 1}, the classes of {self.space.name}"
            raise LabelError(path, f"train ids up to {labels.max()}", expected)
        return labels


def given_labels(folder: Path, file: ScanFile) -> Path:
    """Return the label file of a scan in a folder of predictions, nested or plain."""
    nested = output_path(folder, file.sequence, "predictions", file.stem)
    return nested if present(nested) else folder / nested.name


def _require_some(folder: Path, scans: list[ScanFile]) -> None:
    """Refuse at once what every scan would refuse for itself."""
    if not folder.is_dir():
        found = "not a folder" if present(folder) else "no such folder"
        raise NoInputError(folder, found, "the folder of the labels to refine")
    if not any(present(given_labels(folder, scan)) for scan in scans):
        nested = output_path(Path(), scans[0].sequence, "predictions", scans[0].stem)
        raise NoInputError(
            folder,
            f"no labels of any of {len(scans)} scans",
            f"files like {nested} or {nested.name}",
        )


def labels_of_pixels(image: RangeImage, labels: TrainIds) -> TrainIds:
    """Give every pixel the label of its nearest point: (N,) to (H, W); 0 where empty."""
    occupied = image.point_of_pixel >= 0
    pixels: TrainIds = np.zeros(image.point_of_pixel.shape, np.uint8)
    pixels[occupied] = labels[image.point_of_pixel[occupied]]
    return pixels


def knn_refine_scans(
    out: Path,
    *,
    labels: Path | None = None,
    dataset: Path | None = None,
    usual_dataset: Path = Path(),
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    knn: KnnParameters = KnnParameters(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome[None]:
    """Refine labels into `OUT/sequences/<seq>/predictions`.

    Parameters
    ----------
    out : Path
        The output folder; holds `pixel_labels` unless `labels` is given.
    labels : Path, optional
        A folder of point labels to refine instead, of any origin: `.label` files in the layout of
        the benchmark's predictions, or directly.
    dataset : Path, optional
        Where the scans are, a folder of scans or a data set, if not where those of `out` came from.
    usual_dataset : Path
        Where to look for scans of which nobody recorded where they came from.
    sensor : Sensor, optional
        Otherwise the one that earlier stages recorded in `out`; else the HDL-64.
    space : LabelSpace, optional
        Otherwise the one that `predict` recorded in `out`, else that of the scans' data set.
    knn, selection, options
        Neighbours; which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    if labels and labels.resolve().is_relative_to(out.resolve()):
        raise UsageError("--labels", f"{labels} inside {out}", "a folder that is only read")
    scans = find_scans(dataset) if dataset else remembered_scans(out, None, usual_dataset)
    space = space or recorded_label_space(out) or space_of(scans)
    if labels is None:
        ready = {(file.sequence, file.stem) for file in find_outputs(out, "pixel_labels")}
        scans = [scan for scan in scans if (scan.sequence, scan.stem) in ready]
        if not scans:
            remedy = (
                "run `salsanext predict` on the output of `salsanext project`, or give --labels"
            )
            raise NoInputError(out, "holds no pixel_labels", remedy=remedy)
    scans = choose(scans, selection, space_of(scans, space), out)
    if labels is not None:
        _require_some(labels, scans)
    sensor = sensor or recorded_sensor(out)
    settings = {
        "labels": str(labels.absolute()) if labels else None,
        "label_space": space.to_dict(),
        "sensor": sensor.to_dict(),
        "knn": asdict(knn),
    }
    if labels is None:
        # Labels of other weights must not be kept as those of these.
        settings |= {"origins": origins(out, ["predict"])}
    sources = scans if dataset else ()
    work, writes = RefineScan(out, labels, space, sensor, knn), ("predictions",)
    with claimed(out, "knn-refine", settings, writes, sources, overwrite=options.overwrite):
        return run_over_scans(work, scans, options, is_done=work.is_done)
