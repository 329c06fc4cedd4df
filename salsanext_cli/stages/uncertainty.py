# SPDX-License-Identifier: MIT
"""Scans to labels and uncertainties: Monte-Carlo dropout and assumed density filtering."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.reading import filled
from salsanext_cli.geometry.coverage import FieldOfViewCoverage
from salsanext_cli.geometry.coverage_check import CoverageCheck
from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.inference.settings import NetworkSettings
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import Float, Int
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.predict import most_probable
from salsanext_cli.stages.project import read_and_project
from salsanext_cli.storage.layout import ScanFile, output_path
from salsanext_cli.storage.output_run import claimed
from salsanext_cli.storage.point_files import write_array, write_labels
from salsanext_cli.storage.selection import ScanSelection, select_scans
from salsanext_cli.storage.stage_records import (
    as_json,
    owner,
    recorded_weights,
    stage_settings,
)
from salsanext_cli.uncertainty.settings import Estimator


@dataclass(frozen=True, slots=True)
class UncertaintyOfScan:
    """Estimate the uncertainty of the points of one scan and write it."""

    out: Path
    network: NetworkSettings
    knn: KnnParameters
    estimator: Estimator
    writes: tuple[str, ...]

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the files that are written for a scan."""
        return [self._path(file, folder) for folder in self.writes]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def _path(self, file: ScanFile, folder: str) -> Path:
        return output_path(self.out, file.sequence, folder, file.stem)

    def __call__(self, file: ScanFile) -> FieldOfViewCoverage:
        """Read, project, estimate, refine, write; return how much of the scan is in view."""
        network = self.network.load()
        place, space = str(network.device), network.card.space
        image, seen = read_and_project(file, network.sensor, place)
        estimated = self.estimator.estimate(network, image, file)
        for kind in self.estimator.kinds:
            of_pixels = getattr(estimated.uncertainty, kind)
            of_points = value_of_points(of_pixels, image.pixel_of_point)
            write_array(self._path(file, f"uncertainty/{kind}"), of_points)
        if "predictions" in self.writes:
            pixel_labels = most_probable(estimated.probabilities)
            labels = knn_refine(image, pixel_labels, space.class_count, self.knn, place)
            write_labels(self._path(file, "predictions"), space.to_raw(labels))
        return seen


def _require_same_network(out: Path, settings: dict[str, Any]) -> None:
    """Refuse to put the uncertainty of one network beside the labels of another."""
    stage = owner(out, "predictions")
    recorded = stage_settings(out, stage) if stage not in (None, "uncertainty") else None
    if recorded and (weights := recorded_weights(out, "predictions")):
        recorded["weights"] = weights
    for key, seen in (("weights", str), ("sensor", _view)):
        if recorded and key in recorded and seen(recorded[key]) != seen(as_json(settings[key])):
            raise OutputError(
                out / f"{stage}.json",
                f"labels made with other {key}",
                "the same for labels and uncertainty",
                f"give the same {key}, or use another output folder",
            )


def _view(sensor: dict[str, Any]) -> dict[str, Any]:
    """Leave out what labels do not depend on."""
    return Sensor.from_dict(sensor).view()


def value_of_points(of_pixels: Float, pixel_of_point: Int) -> Float:
    """Give every point its pixel's value: (H, W) to (N,) float32; NaN without a pixel."""
    of_points: Float = of_pixels.ravel()[pixel_of_point]
    of_points[pixel_of_point < 0] = np.nan
    return of_points


def uncertainty(
    source: Path,
    out: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    estimator: Estimator = Estimator(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome[Any]:
    """Estimate uncertainty into `OUT/sequences/<seq>/uncertainty/<kind>`.

    The labels of the mean softmax go to `predictions`, unless another stage keeps its
    labels there already: those stay.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    out : Path
        The output folder.
    network : NetworkChoice
        Weights, device and sensor.
    knn : KnnParameters
        Neighbours of the clean-up of the labels.
    estimator : Estimator
        How; by default 30 passes of Monte-Carlo dropout and one of assumed density filtering.
    selection, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    scans = select_scans(source, selection, network.load().card.space)
    return uncertainty_of(scans, out, network, options, knn=knn, estimator=estimator)


def uncertainty_of(
    scans: list[ScanFile],
    out: Path,
    network: NetworkSettings,
    options: RunOptions,
    *,
    knn: KnnParameters = KnnParameters(),
    estimator: Estimator = Estimator(),
    remembered: bool = False,
) -> Outcome[Any]:
    """Do what `uncertainty` does, to scans already chosen, maybe because `out` remembers them."""
    estimator.require(network.load())
    settings = network.settings() | {"knn": asdict(knn)} | estimator.settings(network.load().sensor)
    folders = tuple(f"uncertainty/{kind}" for kind in estimator.kinds)
    labels_too = owner(out, "predictions") in (None, "uncertainty")
    writes = (*folders, "predictions") if labels_too else folders
    _require_same_network(out, settings)
    sources = () if remembered else scans
    check = CoverageCheck(network.load().sensor)
    with claimed(out, "uncertainty", settings, writes, sources, overwrite=options.overwrite):
        work = UncertaintyOfScan(out, network.resolved(), knn, estimator, writes)
        outcome = run_over_scans(work, scans, options, is_done=work.is_done, on_result=check.add)
    check.finish()
    return outcome
