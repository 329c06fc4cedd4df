# SPDX-License-Identifier: MIT
"""Stage `uncertainty`: scans to labels and uncertainties of their points."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.network_input import noise_of
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import refine_labels
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float, Origins
from salsanext_cli.core.uncertainty.error_features import error_probability, knows_error
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import Estimate
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.fit.sensor_fit import network_of_run, resolved_for, settings_of_network
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import UncertaintySettings
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.paths import ERROR, ORIGINS, ScanFile
from salsanext_cli.runs.results.recorded_names import with_recorded_names
from salsanext_cli.runs.results.recorded_origins import (
    folders_of_origins,
    origin_array,
    origin_in_run,
)
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.results.selection import choose, scans_of, space_of
from salsanext_cli.runs.summary.scan_summary import RunSummary, ScanSummary

METHOD = "sampling"  # Recorded, because earlier versions had another method
Computed = tuple[Estimate, Float | None]  # The softmax (C, H, W) of one pass is for the error model

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UncertaintyJob:
    """Job that estimates the uncertainty of the points of scans, and labels them."""

    network: Network
    knn: KnnParameters
    method: UncertaintyMethod
    output: OutputRun
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.network.sensor, self.origins)
        return read_prepared(file, self.network, origin)

    def compute(self, files: Sequence[PreparedFile]) -> list[Computed]:
        """Estimate the uncertainty of the pixels of scans, one after the other."""
        return [self._estimate(file) for file in files]

    def _estimate(self, prepared: PreparedFile) -> Computed:
        file = prepared.file
        network = prepared.scan.network
        image = prepared.scan.projected.image
        estimate = self.method.estimate(network, image, file.sequence, file.stem)
        network.backend.require_finite(estimate.probabilities, file.path)
        if ERROR not in self.output.folders:
            return estimate, None
        (pixels,) = network.predict([prepared.scan.input], softmax=True)
        network.backend.require_finite(pixels.confidence, file.path)
        return estimate, pixels.softmax

    def finish(self, prepared: PreparedFile, computed: Computed) -> ScanSummary:
        """Write the uncertainty of the points, and their labels."""
        file = prepared.file
        network = prepared.scan.network
        projected = prepared.scan.projected
        image = projected.image
        estimate, softmax = computed
        output = self.output
        if ORIGINS in output.folders:
            output.write_array(file, ORIGINS, origin_array(projected.origin))
        for kind in self.method.kinds:
            of_pixels = getattr(estimate.uncertainty, kind)
            of_points = points_from_pixels(of_pixels, image.pixel_of_point, np.nan)
            output.write_array(file, f"uncertainty/{kind}", of_points)
        if "predictions" not in output.folders:
            return ScanSummary(file=file, check=projected.check)
        space = network.space
        pixels = PixelPrediction.of(estimate.probabilities)
        labels = refine_labels(prepared.scan, pixels, self.knn).labels
        if softmax is not None:
            output.write_array(file, ERROR, error_probability(network, image, softmax, labels))
        output.write_labels(file, space.to_raw(labels))
        return ScanSummary.of_labels(file, labels, space, projected.check)


def uncertainty(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    method: UncertaintyMethod = UncertaintyMethod(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Estimate uncertainty into `OUT/sequences/<seq>/uncertainty/<kind>`.

    The labels of the mean softmax go to `predictions`, unless another stage has its labels there.

    Parameters
    ----------
    source, out : Path
        Scans, and folder of the results.
    settings, knn, method, selection, options
        Network, parameters of kNN, kinds of uncertainty, choice of the scans, and workers.

    Returns
    -------
    Outcome
    """
    network = settings.for_sampling().load()
    listed = with_recorded_names(scans_of(source), out)
    scans = choose(listed, selection, space_of(listed, network.card.space), source)
    # Labels of another stage stay, and so must the sensor with which they were made.
    labels_too = Manifest(out).owner("predictions") in (None, "uncertainty")
    overwrite = options.overwrite and labels_too
    origins = OriginsOfRun(out=out, stage="uncertainty", listed=listed, overwrite=options.overwrite)
    network = network_of_run(
        settings, network, listed, out, overwrite=overwrite, origins_of=origins.of_sample
    )
    method.require(network)
    recorded = replace(
        settings_of_network(network, UncertaintySettings),
        knn=knn,
        method=METHOD,
        aleatoric=method.aleatoric,
        samples=method.samples,
        seed=method.seed,
        noise=noise_of(network.sensor) if method.is_noisy else None,
    )
    folders = _folders(out, network, method, labels_too=labels_too)
    _require_network_of_labels(out, recorded)
    summary = RunSummary.of_network(network, scans)
    run = output_run(out, "uncertainty", recorded, folders, scans, overwrite=options.overwrite)
    with run as output, summary.recorded_in(output, scans):
        by_poses = origins.of_results(output, scans, network.sensor)
        job = partial(UncertaintyJob, knn=knn, method=method, output=output, origins=by_poses)
        task = NetworkTask(
            job=job, settings=resolved_for(settings, network, scans), network=network, batch=1
        )
        return run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)


def _folders(
    out: Path, network: Network, method: UncertaintyMethod, *, labels_too: bool
) -> tuple[str, ...]:
    """Return the folders of the results; `labels_too`: whether the labels are among them."""
    kinds = tuple(f"uncertainty/{kind}" for kind in method.kinds)
    folders = (*kinds, "predictions") if labels_too else kinds
    if knows_error(network) and labels_too:
        folders = (ERROR, *folders)
    elif knows_error(network) and Manifest(out).owner(ERROR) is None:
        text = "no probability of error: the labels in %s are of another stage; use %s"
        log.log(NOTICE, text, out, command("predict", setting("extras", (ERROR,))))
    return (*folders_of_origins(out, "uncertainty", network.sensor), *folders)


def _require_network_of_labels(out: Path, settings: UncertaintySettings) -> None:
    """Refuse to mix the uncertainty of one network with the labels of another."""
    records = Manifest(out)
    stage = records.owner("predictions")
    if stage in (None, "uncertainty") or (recorded := records.settings(stage)) is None:
        return
    before, now = (
        of.sensor and replace(of.sensor.without_noise(), name="") for of in (recorded, settings)
    )
    same = {"sensor": before in (None, now)}
    # Labels of other programs may be in any classes.
    if (weights := records.weights("predictions")) and settings.label_space:
        space = records.label_space("predictions")
        same["weights"] = weights == settings.weights
        same["classes"] = space is not None and space.fits(settings.label_space)
    for name in (name for name, is_same in same.items() if not is_same):
        hint = f"use the same {argument(name)}, or another output folder"
        problem = f"the labels were made with other {name}"
        raise OutputError(records.path(stage), problem, hint=hint)
