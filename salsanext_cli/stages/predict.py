# SPDX-License-Identifier: MIT
"""Stage `predict`: scans to labels in memory, or range images on disk to pixel labels."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import UsageError
from salsanext_cli.fitting.label_scan import (
    LabelledScan,
    label_scan,
    projected_sensor,
    range_image,
    sensor_of_images,
)
from salsanext_cli.fitting.scan_checks import check_image
from salsanext_cli.fitting.scan_fit import fitted_view, network_of_run
from salsanext_cli.fusion.top_classes import top_classes
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.options import KnnParameters, ScanSelection
from salsanext_cli.parallel.run import NetworkTask, Outcome, RunOptions, Steps, run_over_scans
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ERROR, LEAST_CONFIDENCE, ScanFile, with_outputs
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import choose, scans_of, space_of
from salsanext_cli.uncertainty.error_features import error_model, label_error


@dataclass(frozen=True, slots=True)
class LabelWriter:
    """Writer of the results that are asked for of a scan, the labels last."""

    knn: KnnParameters  # Neighbours in the kNN refinement
    output: OutputRun  # Takes the results
    reject: float | None  # Points whose error is above it are unlabelled

    def write(self, scan: LabelledScan, network: Network) -> ScanSummary:
        """Write the results of a scan; return numbers about it."""
        file, image, softmax, labels = scan.file, scan.image, scan.softmax, scan.labels
        space, output = network.space, self.output
        confidence = softmax.max(axis=0)
        doubt = points_from_pixels(1 - confidence, image.pixel_of_point, np.nan)
        output.write_array(file, LEAST_CONFIDENCE, doubt)
        rejected = np.zeros(len(labels), bool)
        if "pixel_labels" in output.folders:
            output.write_array(file, "pixel_labels", most_probable(softmax))
        if "probabilities" in output.folders:
            none = np.eye(1, space.class_count)  # certainly unlabelled
            of_points = points_from_pixels(softmax, image.pixel_of_point, none)
            output.write_array(file, "probabilities", of_points.astype(np.float16))
        if "votes" in output.folders:
            none = np.eye(1, space.class_count)
            of_points = points_from_pixels(softmax, image.pixel_of_point, none)
            output.write_array(file, "votes", top_classes(of_points))
        if ERROR in output.folders:
            error = label_error(network, image, softmax, labels)
            output.write_array(file, ERROR, error)
            if self.reject is not None:
                rejected = error > self.reject
        labels[rejected] = 0
        output.write_labels(file, space.to_raw(labels))
        occupied = image.channels[0] > 0
        mean = float(confidence[occupied].mean()) if occupied.any() else 1.0
        return ScanSummary.of_labels(file, labels, space, scan.check, int(rejected.sum()), mean)


def most_probable(probabilities: Float) -> TrainIds:
    """Return the most probable class of every pixel: (C, H, W) to (H, W) uint8."""
    labels: TrainIds = probabilities.argmax(axis=0).astype(np.uint8)
    return labels


def predict_scan(file: ScanFile, network: Network, writer: LabelWriter) -> Steps:
    """Label the points of one scan, in steps; the last yields numbers about it."""
    writer.output.require_replaceable(file)
    scan = yield from label_scan(file, network, writer.knn)
    yield writer.write(scan, network)


def predict_scans(
    source: Path,
    out: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    extras: tuple[str, ...] = (),
    reject: float | None = None,
    batch: int | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Label scans into `OUT/sequences/<seq>/predictions`, beside their least confidence.

    `extras`: further results to write, of "pixel_labels", "probabilities", "votes" for `fuse` and
    "uncertainty/error";
    `reject`: points whose error, 0…1, is above it are unlabelled, and the error is written too;
    `batch`: scans computed together, halved where memory runs out; None for what suits the device.
    """
    if batch is not None and batch < 1:
        raise UsageError("--batch", str(batch), "at least 1, or auto")
    loaded = network.load()
    found = scans_of(source)
    scans = choose(found, selection, space_of(found, loaded.card.space), source)
    if reject is not None:
        if not 0 <= reject <= 1:
            raise UsageError("--reject", f"{reject:g}", "a probability from 0 to 1")
        extras = tuple(dict.fromkeys((*extras, ERROR)))
    if ERROR in extras:
        if network.adapt:
            found_error = "the probability of errors is of the weights before they adapt"
            raise UsageError("--adapt", found_error, "no --error and no --reject")
        error_model(loaded)
    network, loaded = network_of_run(network, loaded, found, out, overwrite=options.overwrite)
    temperature = loaded.card.temperature
    settings = network.record(loaded) | {"temperature": temperature, "knn": asdict(knn)}
    settings |= {} if reject is None else {"reject": reject}
    summary = RunSummary.of_scans(scans, loaded.sensor, loaded.space)
    folders = (*extras, LEAST_CONFIDENCE, "predictions")
    run = output_run(out, "predict", settings, folders, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        writer = LabelWriter(knn, output, reject)
        label = partial(predict_scan, writer=writer)
        task = NetworkTask(label, network.resolved(loaded), loaded, takes_softmax=True, batch=batch)
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, on_result=summary.add
        )
    rejected = None if reject is None else summary.rejected_points
    return replace(outcome, summary=summary, rejected_points=rejected)


def predict_image(file: ScanFile, network: Network, folder: Path, output: OutputRun) -> Steps:
    """Label the pixels of a range image that `project` wrote into a folder, in steps; check it."""
    output.require_replaceable(file)
    path, image = range_image(file, folder, network.sensor)
    yield
    (probabilities,) = network.pixel_probabilities([image])
    network.engine.require_finite(probabilities, path)
    yield
    output.write_array(file, "pixel_labels", most_probable(probabilities))
    yield ScanSummary(file, check_image(image, network.sensor, network.card.sensor))


def predict_range_images(
    folder: Path,
    out: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Label range images that `project` wrote into `OUT/sequences/<seq>/pixel_labels`.

    `knn_refine_scans` makes point labels of them, the same as `predict_scans` does.
    """
    loaded = network.load()
    projected = projected_sensor(folder)
    if projected is not None:
        found_view = fitted_view([], loaded.sensor, projected, view=network.fits_view)
        loaded = loaded.for_sensor(found_view)
    loaded = loaded.for_sensor(sensor_of_images(folder, projected, loaded.sensor))
    found = with_outputs(ResultFolder(folder).scans(), folder, "range")
    scans = choose(found, selection, space_of(found, loaded.card.space), folder)
    network, loaded = network_of_run(
        *(network, loaded, found, out),
        overwrite=options.overwrite,
        image_of=lambda file: range_image(file, folder, loaded.sensor)[1],
    )
    settings, folders = network.record(loaded), ("pixel_labels",)
    summary = RunSummary(loaded.sensor)
    run = output_run(out, "predict", settings, folders, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        label = partial(predict_image, folder=folder, output=output)
        task = NetworkTask(label, network.resolved(loaded), loaded)
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, on_result=summary.add
        )
    return replace(outcome, summary=summary)
