# SPDX-License-Identifier: MIT
"""Stage `predict`: scans to labels, or range images on disk to pixel labels."""

import csv
import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from salsanext_cli.core.checks.scan_checks import ScanCheck, check_image
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.objects import BOX, Objects, find_objects, fit_boxes
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import LabelledScan, predict_pixels, refine_labels
from salsanext_cli.core.measures.risk_control import guarantee
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float, Origins
from salsanext_cli.core.uncertainty.error_features import error_model, error_probability
from salsanext_cli.core.wording import argument, command, setting, share
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.fit.range_images import projected_sensor, range_image, sensor_of_images
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.fit.sensor_fit import (
    as_typed,
    fitted_view,
    labels_depend_on,
    network_of_run,
    resolved_for,
    settings_of_network,
)
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.paths import (
    ERROR,
    LEAST_CONFIDENCE,
    ORIGINS,
    ScanFile,
    output_path,
    with_outputs,
)
from salsanext_cli.runs.results.recorded_names import with_recorded_names
from salsanext_cli.runs.results.recorded_origins import (
    folders_of_origins,
    origin_array,
    origin_in_run,
    sensor_of_result,
)
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.results.selection import choose, scans_of, space_of
from salsanext_cli.runs.summary.scan_summary import RunSummary, ScanSummary

OF_SOFTMAX = {"probabilities", "votes", ERROR}  # Results that need the whole softmax

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LabelRejection:
    """Rule by which labels are rejected."""

    kind: str  # Kind of uncertainty: error or least_confidence
    threshold: float  # Largest uncertainty of an accepted point
    risk: RiskThreshold | None  # Origin of the threshold

    def recorded_in(self, settings: PredictSettings) -> PredictSettings:
        """Return settings with the rule; the accuracy of accepted labels cannot be estimated."""
        return replace(
            settings,
            reject=self.threshold,
            reject_by=None if self.kind == "error" else self.kind,
            guarantee=self.risk,
            accuracy=None,
        )


@dataclass(frozen=True, slots=True)
class PredictJob:
    """Job that labels the points of scans and writes the requested results, the labels last."""

    network: Network
    knn: KnnParameters
    output: OutputRun
    reject: LabelRejection | None = None
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.network.sensor, self.origins)
        return read_prepared(file, self.network, origin)

    def compute(self, files: Sequence[PreparedFile]) -> list[PixelPrediction]:
        """Predict the pixels of scans, with the softmax if a result needs it."""
        softmax = bool(OF_SOFTMAX & {*self.output.folders})
        return predict_pixels(self.network, [file.scan for file in files], softmax=softmax)

    def finish(self, prepared: PreparedFile, pixels: PixelPrediction) -> ScanSummary:
        """Refine the labels on the points and write the results; return numbers about the scan."""
        file = prepared.file
        network = prepared.scan.network
        scan = refine_labels(prepared.scan, pixels, self.knn)
        image = scan.projected.image
        space = network.space
        output = self.output
        least_confidence = points_from_pixels(1 - pixels.confidence, image.pixel_of_point, np.nan)
        if ORIGINS in output.folders:
            output.write_array(file, ORIGINS, origin_array(scan.projected.origin))
        output.write_array(file, LEAST_CONFIDENCE, least_confidence)
        values = {"least_confidence": least_confidence}
        if "pixel_labels" in output.folders:
            output.write_array(file, "pixel_labels", pixels.labels)
        if pixels.softmax is not None:
            unlabelled = np.eye(1, space.class_count)
            of_points = points_from_pixels(pixels.softmax, image.pixel_of_point, unlabelled)
        if "probabilities" in output.folders:
            output.write_array(file, "probabilities", of_points.astype(np.float16))
        if "votes" in output.folders:
            # Only labels that are to be fused need a part of `fusion`.
            from salsanext_cli.core.fusion.top_classes import top_classes

            output.write_array(file, "votes", top_classes(of_points))
        if ERROR in output.folders and pixels.softmax is not None:
            values["error"] = error_probability(network, image, pixels.softmax, scan.labels)
            output.write_array(file, ERROR, values["error"])
        summary = ScanSummary.of_scan(file, scan, space)
        known = least_confidence[~np.isnan(least_confidence)]
        confidence = 1 - float(known.mean()) if known.size else np.nan
        summary = replace(summary, confidence=confidence)
        if self.reject:
            rejected = values[self.reject.kind] > np.float32(self.reject.threshold)
            if self.reject.risk:
                summary = summary.with_traits(scan, values[self.reject.kind])
            summary = summary.without_rejected(rejected, scan.labels, values[self.reject.kind])
            scan = replace(scan, labels=np.where(rejected, np.uint8(0), scan.labels))
        raw = space.to_raw(scan.labels)
        if "objects" in output.folders:
            objects = find_objects(image, scan.labels, space.movable)
            output.write(output.path(file, "objects"), _object_table(scan, objects, space))
            raw |= objects.astype(np.uint32) << 16
        output.write_labels(file, raw)
        return summary


def _object_table(scan: LabelledScan, objects: Objects, space: LabelSpace) -> bytes:
    """Return the .csv table of the class, the number of points and the box of each object."""
    file, sizes = io.StringIO(), np.bincount(objects)
    of_object = np.zeros(len(sizes), np.uint8)
    of_object[objects] = scan.labels
    table = csv.writer(file, lineterminator="\n")
    table.writerow(("object", "class", "points", *BOX))
    is_car = np.isin(of_object[1:], [i for i, name in enumerate(space.names) if name == "car"])
    boxes = fit_boxes(scan.projected.scan.points, objects, is_car, scan.projected.sensor.origin[:2])
    for number, box in enumerate(boxes, 1):
        name, numbers = space.names[of_object[number]], [f"{value:.3f}" for value in box]
        table.writerow((number, name, sizes[number], *numbers))
    return file.getvalue().encode()


def predict_scans(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    extras: tuple[str, ...] = (),
    reject: float | Literal["risk"] | None = None,
    batch: int | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Label scans into `OUT/sequences/<seq>/predictions`, with their least confidence.

    Parameters
    ----------
    source, out : Path
        Scans, and folder of the results.
    settings, knn, selection, options
        Network, parameters of kNN, choice of the scans, and workers.
    extras : tuple of str
        Further results: pixel_labels, probabilities, votes, objects, uncertainty/error.
    reject, batch : optional
        Error above which points are unlabelled, or "risk"; number of scans computed together.

    Returns
    -------
    Outcome
    """
    if batch is not None and batch < 1:
        raise UsageError(argument("batch"), str(batch), "at least 1, or auto")
    network = settings.load()
    listed = with_recorded_names(scans_of(source), out)
    scans = choose(listed, selection, space_of(listed, network.card.space), source)
    overwrite = options.overwrite
    origins = OriginsOfRun(out=out, stage="predict", listed=listed, overwrite=overwrite)
    fit = partial(network_of_run, settings, network, listed, out, overwrite=overwrite)
    network = fit(origins_of=origins.of_sample)
    rejection = None if reject is None else _rejection(reject, settings, network, knn)
    extras = _possible_extras(extras, rejection, network)
    recorded = _recorded_settings(network, knn, extras, rejection)
    threshold = rejection.risk if rejection else None
    summary = RunSummary.of_network(network, scans, recorded.accuracy, threshold)
    folders = (*extras, LEAST_CONFIDENCE, "predictions")
    folders = (*folders_of_origins(out, "predict", network.sensor), *folders)
    run = output_run(
        out, "predict", recorded, folders, scans, overwrite=overwrite, weights=settings.named_path
    )
    with run as output, summary.recorded_in(output, scans):
        by_poses = origins.of_results(output, scans, network.sensor)
        job = partial(PredictJob, knn=knn, output=output, reject=rejection, origins=by_poses)
        task = NetworkTask(
            job=job, settings=resolved_for(settings, network, scans), network=network, batch=batch
        )
        outcome = run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)
    return replace(outcome, rejected_points=summary.rejected_points if rejection else None)


def _recorded_settings(
    network: Network, knn: KnnParameters, extras: tuple[str, ...], rejection: LabelRejection | None
) -> PredictSettings:
    """Return the settings to record."""
    settings = replace(
        settings_of_network(network, PredictSettings),
        temperature=network.card.temperature,
        knn=knn,
        accuracy=network.card.accuracy,
        objects="objects" in extras or None,
    )
    return rejection.recorded_in(settings) if rejection else settings


def _possible_extras(
    extras: tuple[str, ...], rejection: LabelRejection | None, network: Network
) -> tuple[str, ...]:
    """Return the further results with those that the rejection needs; refuse impossible ones."""
    if rejection and rejection.kind == "error":
        extras = tuple(dict.fromkeys((*extras, ERROR)))
    if ERROR in extras:
        error_model(network)
    if "objects" in extras:
        network.space.require_movable(setting("extras", ("objects",)))
    return extras


def _rejection(
    reject: float | str, settings: NetworkSettings, network: Network, knn: KnnParameters
) -> LabelRejection:
    """Return the rule of `predict_scans`, which takes the same argument."""
    risk = _chosen_threshold(settings, network, knn) if reject == "risk" else None
    threshold = risk.threshold if risk else reject
    if isinstance(threshold, str) or not 0 <= threshold <= 1:
        raise UsageError(argument("reject"), str(threshold), "a probability from 0 to 1")
    return LabelRejection(kind=risk.kind if risk else "error", threshold=threshold, risk=risk)


def _chosen_threshold(
    settings: NetworkSettings, network: Network, knn: KnnParameters
) -> RiskThreshold:
    """Return the threshold in the weights; refuse settings that its guarantee does not cover."""
    risk = network.card.risk
    if risk is None:
        wanted = [share("at_most", 0.05)]
        if settings.width:
            wanted.append(setting("width", settings.width))
        tune = command("salsanext tune risk DATASET WEIGHTS_OUT", *wanted)
        hint = f"choose one with `{tune}`"
        problem = f"has no threshold of risk for images of {network.sensor.width} columns"
        raise WeightsError(network.backend.name, problem, hint=hint)
    tuned, current = risk.settings, labels_depend_on(settings, network)
    rejected = setting("reject", "risk")
    others = {"classes": network.merging is not None, "knn": knn != KnnParameters()}
    others |= {name: current[key] != tuned.get(key) for name, key in KEY_OF.items()}
    if changed := [name for name, is_other in others.items() if is_other]:
        name = changed[0]
        problem = f"the guarantee of `{rejected}` does not cover other labels"
        if name in KEY_OF and name != "sensor":
            runs = (tuned, current)
            before, now = (as_typed(name, of_run.get(KEY_OF[name])) for of_run in runs)
            problem = f"the threshold was chosen with {before}, this run has {now}"
        hint = "use the option as for `tune risk`, or run `tune risk` again"
        raise UsageError(argument(name), problem, hint=hint)
    log.log(NOTICE, "%s: %s", rejected, guarantee(risk))
    return risk


class PreparedImage(NamedTuple):
    """Range image of `project`, ready for a network."""

    file: ScanFile
    input: Float  # (1, 5, H, W) float32, normalised, for the sensor of the scan
    check: ScanCheck  # Reasons to doubt the scan


@dataclass(frozen=True, slots=True)
class PredictImageJob:
    """Job that labels the pixels of range images in a folder."""

    network: Network
    folder: Path
    output: OutputRun

    def prepare(self, file: ScanFile) -> PreparedImage:
        """Read and check a range image, whose sensor may depend on the scan."""
        self.output.require_replaceable(file)
        network = self.network
        if network.sensor.others:
            scan = read_scan(file.path, network.sensor)
            of_scan = sensor_of_result(self.folder, file, scan, network.sensor)
            network = network.for_sensor(of_scan)
        image = range_image(file, self.folder, network.sensor)
        check = check_image(image, network.sensor, network.card.sensor)
        return PreparedImage(file, network.input(image), check)

    def compute(self, scans: Sequence[PreparedImage]) -> list[PixelPrediction]:
        """Predict the pixels of images."""
        return self.network.predict([scan.input for scan in scans])

    def finish(self, scan: PreparedImage, pixels: PixelPrediction) -> ScanSummary:
        """Write the labels of the pixels."""
        path = output_path(self.folder, scan.file.sequence, "range", scan.file.stem)
        self.network.backend.require_finite(pixels.confidence, path)
        self.output.write_array(scan.file, "pixel_labels", pixels.labels)
        return ScanSummary(file=scan.file, check=scan.check)


def predict_range_images(
    folder: Path,
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Label range images of `project` into `OUT/sequences/<seq>/pixel_labels`.

    Parameters
    ----------
    folder, out : Path
        Output folder of `project`, and folder of the results.
    settings, selection, options
        Network, choice of the scans, and workers.

    Returns
    -------
    Outcome
    """
    network = settings.load()
    projected = projected_sensor(folder)
    fitted = fitted_view(
        [], network.sensor, projected, view=settings.fits_view, mounting=settings.fits_mounting
    )
    network = network.for_sensor(sensor_of_images(folder, projected, fitted))
    listed = with_outputs(ResultFolder(folder).scans(), folder, "range")
    scans = choose(listed, selection, space_of(listed, network.card.space), folder)
    images = partial(range_image, folder=folder, sensor=network.sensor)
    overwrite = options.overwrite
    origins = OriginsOfRun(out=folder, stage="predict", listed=listed)
    network = network_of_run(
        settings,
        network,
        listed,
        out,
        overwrite=overwrite,
        image_of=images,
        origins_of=origins.of_sample,
    )
    recorded = settings_of_network(network, PredictSettings)
    folders = ("pixel_labels",)
    summary = RunSummary(sensor=network.sensor, trained=network.card.sensor)
    run = output_run(
        out, "predict", recorded, folders, scans, overwrite=overwrite, weights=settings.named_path
    )
    with run as output, summary.recorded_in(output, scans):
        job = partial(PredictImageJob, folder=folder, output=output)
        task = NetworkTask(job=job, settings=settings.resolved(network), network=network)
        return run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)
