# SPDX-License-Identifier: MIT
"""Scans to labels: projection, network and kNN in memory; or range images to pixel labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.errors import UsageError
from salsanext_cli.formats.reading import filled
from salsanext_cli.geometry.coverage import FieldOfViewCoverage
from salsanext_cli.geometry.coverage_check import CoverageCheck
from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.inference.predict_batches import predict_batches, usual_size
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.parallel.tasks import Attempt, Attempts, one_by_one
from salsanext_cli.records import Float, Int
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.project import projected_sensor, read_and_project, read_channels
from salsanext_cli.storage.layout import ScanFile, find_outputs, output_path
from salsanext_cli.storage.output_run import claimed
from salsanext_cli.storage.point_files import write_array, write_labels
from salsanext_cli.storage.selection import ScanSelection, choose, select_scans, space_of
from salsanext_cli.storage.sources import remembered_scans


@dataclass(frozen=True, slots=True)
class PredictScan:
    """Label the points of one scan."""

    out: Path
    network: NetworkSettings
    knn: KnnParameters
    extras: tuple[str, ...]
    batch: int | None = None

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the files that are written for a scan."""
        return [self._path(file, folder) for folder in ("predictions", *self.extras)]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def _path(self, file: ScanFile, folder: str) -> Path:
        return output_path(self.out, file.sequence, folder, file.stem)

    def __call__(self, file: ScanFile) -> FieldOfViewCoverage:
        """Read, project, classify, refine, write; return how much of the scan is in view."""
        network = self.network.load()
        place, space = str(network.device), network.card.space
        image, seen = read_and_project(file, network.sensor, place)
        probabilities = network.probabilities(image)
        pixel_labels = most_probable(probabilities)
        labels = knn_refine(image, pixel_labels, space.class_count, self.knn, place)
        self._write(space, file, labels, pixel_labels, probabilities, image.pixel_of_point)
        return seen

    def open(self) -> Attempts:
        """Return what attempts several scans."""
        return self.attempts

    def attempts(self, files: Iterable[ScanFile]) -> Iterator[Attempt]:
        """Do the same to several scans, on a GPU in batches; see `predict_batches`."""
        network = self.network.load()
        size = self.batch or usual_size(network)
        if size == 1 and network.device.type == "cpu":
            return one_by_one(self, files)
        wanted = "probabilities" in self.extras
        write = partial(self._write, network.card.space)
        return predict_batches(files, network, self.knn, size, write, probabilities=wanted)

    def _write(
        self,
        space: LabelSpace,
        file: ScanFile,
        labels: TrainIds,
        pixel_labels: TrainIds,
        probabilities: Float | None,
        pixel_of_point: Int,
    ) -> None:
        if "pixel_labels" in self.extras:
            write_array(self._path(file, "pixel_labels"), pixel_labels)
        if "probabilities" in self.extras and probabilities is not None:
            of_points = point_probabilities(probabilities, pixel_of_point)
            write_array(self._path(file, "probabilities"), of_points)
        write_labels(self._path(file, "predictions"), space.to_raw(labels))


@dataclass(frozen=True, slots=True)
class PredictImage:
    """Label the pixels of one range image that `project` wrote."""

    folder: Path
    out: Path
    network: NetworkSettings

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the file that is written for a range image."""
        return [output_path(self.out, file.sequence, "pixel_labels", file.stem)]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def __call__(self, file: ScanFile) -> None:
        """Read, classify, write."""
        network = self.network.load()
        path = output_path(self.folder, file.sequence, "range", file.stem)
        channels = read_channels(path, network.sensor)
        pixel_labels = most_probable(network.pixel_probabilities(channels))
        write_array(self.results_of(file)[0], pixel_labels)


def most_probable(probabilities: Float) -> TrainIds:
    """Return the most probable class of every pixel: (C, H, W) to (H, W) uint8."""
    labels: TrainIds = probabilities.argmax(axis=0).astype(np.uint8)
    return labels


def point_probabilities(probabilities: Float, pixel_of_point: Int) -> npt.NDArray[np.float16]:
    """Give every point its pixel's softmax: (N, C) float16; points without a pixel are class 0."""
    of_points = probabilities.reshape(len(probabilities), -1).T[pixel_of_point].astype(np.float16)
    of_points[pixel_of_point < 0] = np.eye(1, of_points.shape[1])
    return of_points


def predict(
    source: Path,
    out: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    extras: tuple[str, ...] = (),
    batch: int | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome[Any]:
    """Label scans into `OUT/sequences/<seq>/predictions`.

    Given the output folder of `project_scans`, label its range images into `pixel_labels`
    instead; `knn_refine_scans` makes point labels of them, the same as in one go.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence, a data set, or what `project_scans` wrote.
    out : Path
        The output folder.
    network : NetworkChoice
        Weights, device and sensor.
    knn : KnnParameters
        Neighbours of the clean-up.
    extras : tuple of {"pixel_labels", "probabilities"}
        Intermediate results to keep.
    batch : int, optional
        Scans computed together, at least 1; by default one on a CPU, on a GPU as many as keep it
        busy. Halved where memory runs out.
    selection, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    if batch is not None and batch < 1:
        raise UsageError("--batch", str(batch), "at least 1, or auto")
    seen = projected_sensor(source)
    if seen is not None and batch is not None:
        raise UsageError("--batch", "range images are computed one by one", "scans")
    if seen is not None:
        _require_same_sensor(source, seen, network.load().sensor)
        if knn != KnnParameters():
            found = "range images are refined by knn-refine"
            raise UsageError("--knn-…", found, "the options given there")
        return _predict_images(source, out, network, extras, selection, options)
    loaded = network.load()
    card = loaded.card
    scans = select_scans(source, selection, card.space)
    settings = network.settings() | {"temperature": card.temperature, "knn": asdict(knn)}
    check, writes = CoverageCheck(loaded.sensor), ("predictions", *extras)
    with claimed(out, "predict", settings, writes, scans, overwrite=options.overwrite):
        work = PredictScan(out, network.resolved(), knn, extras, batch)
        outcome = run_over_scans(work, scans, options, is_done=work.is_done, on_result=check.add)
    check.finish()
    return outcome


def _predict_images(
    folder: Path,
    out: Path,
    network: NetworkSettings,
    extras: tuple[str, ...],
    selection: ScanSelection,
    options: RunOptions,
) -> Outcome[None]:
    if "probabilities" in extras:
        found = "range images do not say which points they are of"
        raise UsageError("--probabilities", found, "the scans themselves")
    ready = {(file.sequence, file.stem) for file in find_outputs(folder, "range")}
    scans = [scan for scan in remembered_scans(folder) if (scan.sequence, scan.stem) in ready]
    scans = choose(scans, selection, space_of(scans, network.load().card.space), folder)
    settings = network.settings()
    writes = ("pixel_labels",)
    with claimed(out, "predict", settings, writes, scans, overwrite=options.overwrite):
        work = PredictImage(folder, out, network.resolved())
        return run_over_scans(work, scans, options, is_done=work.is_done)


def _require_same_sensor(folder: Path, seen: Sensor, wanted: Sensor) -> None:
    """Refuse images of another geometry; what normalises them is the network's own affair."""
    if replace(seen, means=wanted.means, stds=wanted.stds).view() != wanted.view():
        raise UsageError(
            folder,
            f"range images of {seen.name}, {seen.height}×{seen.width}",
            f"{wanted.name}, {wanted.height}×{wanted.width}, as the weights or --sensor say",
            "project again, or give the sensor that was projected with",
        )
