# SPDX-License-Identifier: MIT
"""Scans that one part of the weights is fitted to, and their labels point by point."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.records import Float, Indices, Origin, Origins, RangeImage
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans
from salsanext_cli.runs.loop.job import Computed, Prepared, ScanJob
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.loop.run_origins import OriginsOfSource
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.sources import read_labelled
from salsanext_cli.training.data.targets import class_sets

NOT_SCORED = "no point is of a scored class"

Fit = TypeVar("Fit")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, kw_only=True)
class Tuned(Generic[Fit]):
    """Result of a fit of one part of the weights."""

    card: WeightsCard  # Of the new weights
    fit: Fit  # Report of the fit, a record


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FitOfScans:
    """Network that is fitted to scans, and the origins of those that are registered."""

    network: Network
    origins: Origins

    @classmethod
    def from_files(
        cls, files: Sequence[ScanFile], source: Path, settings: NetworkSettings, loaded: Network
    ) -> "FitOfScans":
        """Fit a network to a source as `predict` does, by poses where there are any.

        Parameters
        ----------
        files : sequence of ScanFile
            Scans whose origins are needed.
        source : Path
            Their source, to whose scans the sensor is fitted.
        settings : NetworkSettings
            What to fit.
        loaded : Network
            Network as it is in its file.

        Returns
        -------
        FitOfScans
        """
        by_poses = OriginsOfSource(listed=find_scans(source))
        sample = sample_of_files(by_poses.listed, loaded.sensor, origins_of=by_poses.sample_origins)
        fitted = fit_scans(settings, loaded, sample)
        settings.announce(fitted)
        return cls(network=fitted, origins=by_poses.scan_origins(files, fitted.sensor))


@dataclass(frozen=True, eq=False, kw_only=True)
class TuningScans:
    """Scans that a part of the weights is fitted to; `space` holds the classes of their labels."""

    source: Path
    files: list[ScanFile]
    space: LabelSpace
    settings: NetworkSettings
    loaded: Network  # As it is in its file
    progress: Callable[[int, int], object] | None = None  # Called after each scan

    @property
    def network(self) -> Network:
        """Network fitted to the sensor of the scans, which are read at the first use."""
        return self._fit.network

    @property
    def origins(self) -> Origins:
        """Origins of registered scans by the poses of their sequences, as `predict` takes them."""
        return self._fit.origins

    @cached_property
    def _fit(self) -> FitOfScans:
        return FitOfScans.from_files(self.files, self.source, self.settings, self.loaded)

    def read(self, file: ScanFile) -> "LabelledImage":
        """Read and project a scan with its labels."""
        return read_labelled_image(file, self.network, self.space, self.origins.get(file.name))

    def run(self, job: ScanJob[Prepared, Computed, Result]) -> dict[ScanFile, Result]:
        """Run a job on the scans and return its results; report progress after each scan."""
        results: dict[ScanFile, Result] = {}
        computed = network_pipeline(job, self.network).results(self.files)
        for file, result in zip(self.files, computed, strict=True):
            results[file] = result
            if self.progress:
                self.progress(len(results), len(self.files))
        return results

    def require_points(self, points: int) -> None:
        """Raise `LabelError` if there is no point to learn from."""
        if not points:
            raise LabelError(self.source, NOT_SCORED, f"labels of {self.space.name}")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledImage:
    """Range image of a whole scan, and its M points with a pixel and a single scored class."""

    file: ScanFile
    network: Network  # For the sensor of the scan
    image: RangeImage
    points: Indices  # (M,): their indices in the scan
    truth: TrainIds  # (M,) uint8
    # Share of the labelled points with a pixel whose label is of several classes
    ambiguous_share: float

    @property
    def input(self) -> Float:
        """Input of the network, (1, 5, H, W) float32, normalised."""
        return self.network.input(self.image.channels)

    def point_values(self, pixel_values: Float) -> Float:
        """Return the pixel values (C, H, W) of the points, (M, C)."""
        pixels = self.image.pixel_of_point[self.points]
        return pixel_values.reshape(len(pixel_values), -1)[:, pixels].T


def read_labelled_image(
    file: ScanFile, network: Network, space: LabelSpace, origin: Origin | None = None
) -> LabelledImage:
    """Read a scan with its labels and project it; `origin` as of `sensor_of`."""
    annotated = read_labelled(file, space, network.sensor, class_sets([space]))
    scan = annotated.scan
    targets = annotated.labels
    network = network.for_sensor(sensor_of(scan, network.sensor, origin))
    image = project(scan, network.sensor)
    is_scored = np.isin(targets, np.flatnonzero(space.scored))
    has_pixel = image.pixel_of_point >= 0
    points = np.flatnonzero(is_scored & has_pixel)
    ambiguous = int(((targets >= space.class_count) & has_pixel).sum())
    return LabelledImage(
        file=file,
        network=network,
        image=image,
        points=points,
        truth=targets[points],
        ambiguous_share=ambiguous / max(len(points) + ambiguous, 1),
    )
