# SPDX-License-Identifier: MIT
"""Stage `predict`: scans to labels in memory, or range images on disk to pixel labels."""

import csv
import io
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.engines.loading import load_network
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, NoInputError, UsageError, WeightsError
from salsanext_cli.files.locks import temporary_folder
from salsanext_cli.fitting.label_scan import (
    LabelledScan,
    label_scan,
    labelled,
    project_for,
    projected_sensor,
    range_image,
    sensor_of_images,
)
from salsanext_cli.fitting.scan_checks import check_image
from salsanext_cli.fitting.scan_fit import (
    fit_network,
    fitted_view,
    is_other_view,
    labels_depend_on,
    network_of_run,
    settings_of_network,
)
from salsanext_cli.formats import read_scan
from salsanext_cli.fusion.top_classes import top_classes
from salsanext_cli.fusion.window import movable_classes
from salsanext_cli.geometry.objects import BOX, Objects, find_objects, fit_boxes
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.geometry.scan_traits import sensor_of
from salsanext_cli.measures.risk_control import promise
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.network.card import RiskThreshold
from salsanext_cli.options import KnnParameters, ScanSelection
from salsanext_cli.parallel.run import NetworkTask, Outcome, RunOptions, ScanSteps, run_over_scans
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.layout import (
    ERROR,
    LEAST_CONFIDENCE,
    ScanFile,
    drive_order,
    with_outputs,
)
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import choose, scans_of, space_of
from salsanext_cli.stages.fuse import FUSED, fuse_results, require_fusable
from salsanext_cli.uncertainty.error_features import error_model, error_probability, knows_error

IN_MEMORY = ScanFile("scan", "points", Path("points"))
"""Name of the points in warnings and errors."""

OTHER_VIEW = (
    "the view fitted to these scans is not that of the scans that the threshold was chosen on: of "
    "another sensor or mounting nothing is promised; choose it with `tune risk` on its own scans"
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class LabelRejection:
    """Rule by which points are left unlabelled."""

    kind: str  # Kind of uncertainty: error or least_confidence
    above: Float  # (C,): largest uncertainty of an accepted point, by its label


@dataclass(frozen=True, slots=True)
class LabelWriter:
    """Writer of the results that are asked for of a scan, the labels last."""

    knn: KnnParameters  # Neighbours in the kNN refinement
    output: OutputRun  # Takes the results
    reject: LabelRejection | None = None

    def write(self, scan: LabelledScan, network: Network) -> ScanSummary:
        """Write the results of a scan; return numbers about it."""
        file, image, softmax, space = scan.file, scan.image, scan.softmax, network.space
        output = self.output
        least_confidence = points_from_pixels(1 - softmax.max(axis=0), image.pixel_of_point, np.nan)
        output.write_array(file, LEAST_CONFIDENCE, least_confidence)
        values = {"least_confidence": least_confidence}
        if "pixel_labels" in output.folders:
            output.write_array(file, "pixel_labels", softmax.argmax(axis=0).astype(np.uint8))
        if {"probabilities", "votes"} & {*output.folders}:
            none = np.eye(1, space.class_count)  # certainly unlabelled
            of_points = points_from_pixels(softmax, image.pixel_of_point, none)
        if "probabilities" in output.folders:
            output.write_array(file, "probabilities", of_points.astype(np.float16))
        if "votes" in output.folders:
            output.write_array(file, "votes", top_classes(of_points))
        if ERROR in output.folders:
            values["error"] = error_probability(network, image, softmax, scan.labels)
            output.write_array(file, ERROR, values["error"])
        if self.reject:
            rejected = values[self.reject.kind] > self.reject.above[scan.labels]
            scan = replace(scan, labels=np.where(rejected, np.uint8(0), scan.labels))
        else:
            rejected = np.zeros(len(scan.labels), bool)
        raw = space.to_raw(scan.labels)
        if "objects" in output.folders:
            objects = find_objects(image, scan.labels, movable_classes(space))
            output.write(output.path(file, "objects"), object_table(scan, objects, space))
            raw |= objects.astype(np.uint32) << 16
        output.write_labels(file, raw)
        summary = ScanSummary.of_scan(scan, space, int(rejected.sum()))
        known = least_confidence[~np.isnan(least_confidence)]
        return replace(summary, confidence=1 - float(known.mean()) if known.size else np.nan)


def object_table(scan: LabelledScan, objects: Objects, space: LabelSpace) -> bytes:
    """Return a table with class, number of points and box of each object, in its order."""
    file, sizes = io.StringIO(), np.bincount(objects)
    of_object = np.zeros(len(sizes), np.uint8)
    of_object[objects] = scan.labels
    table = csv.writer(file, lineterminator="\n")
    table.writerow(("object", "class", "points", *BOX))
    for number, box in enumerate(fit_boxes(scan.scan.points, objects), 1):
        name, numbers = space.names[of_object[number]], [f"{value:.3f}" for value in box]
        table.writerow((number, name, sizes[number], *numbers))
    return file.getvalue().encode()


def predict_scan(file: ScanFile, network: Network, writer: LabelWriter) -> ScanSteps:
    """Label the points of one scan, in steps; the last yields numbers about it."""
    writer.output.require_replaceable(file)
    scan = yield from label_scan(file, network, writer.knn)
    yield writer.write(scan, network)


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
    """Label scans into `OUT/sequences/<seq>/predictions`, beside their least confidence.

    `extras`: further results, of "pixel_labels", "probabilities", "votes", "objects" and
    "uncertainty/error"; `reject`: error, 0…1, above which points are unlabelled, or "risk" for the
    thresholds in the weights; `batch`: scans computed together, None for what suits the device.
    """
    if batch is not None and batch < 1:
        raise UsageError("--batch", str(batch), "at least 1, or auto")
    network = settings.load()
    found = scans_of(source)
    scans = choose(found, selection, space_of(found, network.card.space), source)
    risk = _chosen_threshold(settings, network, knn) if reject == "risk" else None
    above = risk.threshold if risk else reject
    if isinstance(above, str) or not 0 <= (above or 0) <= 1:
        raise UsageError("--reject", f"{above}", "a probability from 0 to 1")
    kind = risk.kind if risk else "error"
    if above is not None and kind == "error":
        extras = tuple(dict.fromkeys((*extras, ERROR)))
    if ERROR in extras:
        error_model(network)
    network = network_of_run(settings, network, found, out, overwrite=options.overwrite)
    _warn_of_other_view(risk, network)
    accuracy = network.card.accuracy if above is None else None
    recorded = replace(
        settings_of_network(network),
        temperature=network.card.temperature,
        knn=knn,
        reject=above,
        reject_by=None if kind == "error" else kind,
        accuracy=accuracy,
        promised=risk,
        objects="objects" in extras or None,
    )
    rejection = None
    if above is not None:
        of_classes = risk.classes if risk else {}
        limits = [of_classes.get(name, above) for name in network.space.names]
        rejection = LabelRejection(kind, np.array(limits, np.float32))
    summary = RunSummary.of_scans(scans, network.sensor, network.space, accuracy)
    folders = (*extras, LEAST_CONFIDENCE, "predictions")
    run = output_run(out, "predict", recorded, folders, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        function = partial(predict_scan, writer=LabelWriter(knn, output, rejection))
        task = NetworkTask(
            function, settings.resolved(network), network, takes_softmax=True, batch=batch
        )
        outcome = run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)
    return replace(outcome, rejected_points=summary.rejected_points if rejection else None)


def _chosen_threshold(
    settings: NetworkSettings, network: Network, knn: KnnParameters
) -> RiskThreshold:
    """Return the threshold in the weights; refuse settings that its guarantee does not cover."""
    risk = network.card.risk
    if risk is None:
        remedy = "`salsanext tune risk DATASET WEIGHTS_OUT --at-most 5%` chooses one"
        raise WeightsError(network.engine.name, "no threshold of risk", "weights with one", remedy)
    tuned, given = risk.settings, labels_depend_on(settings, network)
    others = {"--classes": network.merging, "--knn-…": knn != KnnParameters()}
    others |= {name: given[name] != tuned.get(name) for name in given}
    if changed := [name for name, is_other in others.items() if is_other]:
        found = "the guarantee of `--reject risk` does not cover other labels"
        raise UsageError(changed[0], found, "the settings of `tune risk`")
    log.log(NOTICE, "--reject risk: %s", promise(risk))
    return risk


def _warn_of_other_view(risk: RiskThreshold | None, network: Network) -> None:
    """Warn if a sensor was fitted otherwise than those that the threshold was chosen for."""
    views, members = risk.views if risk else (), network.sensor.members
    if views and any(all(is_other_view(view, each) for view in views) for each in members):
        log.warning("--reject risk: %s", OTHER_VIEW)


def predict_image(file: ScanFile, network: Network, folder: Path, output: OutputRun) -> ScanSteps:
    """Label the pixels of a range image that `project` wrote into a folder, in steps; check it."""
    output.require_replaceable(file)
    if network.sensor.others:
        scan = read_scan(file.path, network.sensor)
        network = network.for_sensor(sensor_of(scan, network.sensor))
    path, image = range_image(file, folder, network.sensor)
    yield
    (probabilities,) = network.pixel_probabilities([image])
    network.engine.require_finite(probabilities, path)
    yield
    output.write_array(file, "pixel_labels", probabilities.argmax(axis=0).astype(np.uint8))
    yield ScanSummary(file, check_image(image, network.sensor, network.card.sensor))


def predict_range_images(
    folder: Path,
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Label range images that `project` wrote into `OUT/sequences/<seq>/pixel_labels`."""
    network = settings.load()
    projected = projected_sensor(folder)
    seen = fitted_view([], network.sensor, projected, view=settings.fits_view)
    network = network.for_sensor(sensor_of_images(folder, projected, seen))
    found = with_outputs(ResultFolder(folder).scans(), folder, "range")
    scans = choose(found, selection, space_of(found, network.card.space), folder)
    network = network_of_run(
        settings,
        network,
        found,
        out,
        overwrite=options.overwrite,
        image_of=lambda file: range_image(file, folder, network.sensor)[1],
    )
    recorded, folders = settings_of_network(network), ("pixel_labels",)
    summary = RunSummary(network.sensor)
    run = output_run(out, "predict", recorded, folders, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        steps = partial(predict_image, folder=folder, output=output)
        task = NetworkTask(steps, settings.resolved(network), network)
        return run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)


class PointLabels(NamedTuple):
    """Result of `label`."""

    labels: TrainIds
    probabilities: Float
    error: Float | None


def label(
    points: npt.ArrayLike,
    intensity: npt.ArrayLike | None = None,
    weights: Path | str | Network | None = None,
) -> PointLabels:
    """Label the points of one scan, as `predict` does: fitted, checked, refined.

    Reasons to doubt the labels are logged as warnings of ``salsanext_cli``.

    Parameters
    ----------
    points : (N, 3) numbers
        Coordinates in metres around the sensor. Those that are NaN, infinite or 0 get label 0.
    intensity : (N,) numbers, optional
        Of any scale; None where there is none.
    weights : Path, str or Network, optional
        A weights file, None for the default weights: loaded, and fitted to these points. A network
        is taken as it is, which saves both for many scans: fit it by `fit_network`.

    Returns
    -------
    labels : (N,) uint8
        Train ids of the label space of the weights, ``sn.label_space()`` for the default ones.
    probabilities : (N, C) float32
        Of the pixel of each point, of class 0 alone without one; labels are refined besides.
    error : (N,) float32 or None
        Probability that each label is wrong, NaN without a pixel; None if the weights lack it.

    Raises
    ------
    SalsanextError
        If the arrays cannot be points in metres around a sensor, or the weights cannot be used.
    """
    scan = _scan(points, intensity)
    network = weights
    if not isinstance(network, Network):
        network = fit_network(load_network(weights), [scan])  # type: ignore[arg-type]
    network, projected = project_for(network, IN_MEMORY, scan)
    softmax = network.probabilities(projected.image, IN_MEMORY.path)
    done = labelled(projected, softmax, network, KnnParameters())
    RunSummary(network.sensor).add(ScanSummary.of_scan(done, network.space))
    none = np.eye(1, network.space.class_count)
    of_points = points_from_pixels(softmax, done.image.pixel_of_point, none)
    known = knows_error(network)
    error = error_probability(network, done.image, softmax, done.labels) if known else None
    return PointLabels(done.labels, of_points, error)


def _scan(points: npt.ArrayLike, intensity: npt.ArrayLike | None) -> Scan:
    """Check the arrays and return the scan that they are; a scan without intensity has 0."""
    try:
        coordinates = np.asarray(points)
    except ValueError:  # Lists of several lengths
        coordinates = np.array("lists of several lengths")
    if coordinates.ndim != 2 or coordinates.shape[1] != 3 or coordinates.dtype.kind not in "fiu":
        found = f"an array {coordinates.shape} of {coordinates.dtype}"
        remedy = "of x, y, z, intensity: label(array[:, :3], array[:, 3])"
        raise UsageError("points", found, "numbers (N, 3), in metres", remedy)
    values = np.zeros(len(coordinates)) if intensity is None else np.asarray(intensity)
    if values.shape != coordinates.shape[:1] or values.dtype.kind not in "fiu":
        found = f"an array {values.shape} of {values.dtype}"
        raise UsageError("intensity", found, f"numbers ({len(coordinates)},), one per point")
    # What float32 cannot hold is infinite: no measurement.
    with np.errstate(over="ignore", invalid="ignore"):
        return Scan(coordinates.astype(np.float32), values.astype(np.float32))


class FusedScan(NamedTuple):
    """Scan of `label_drive`."""

    name: str
    scan: Scan
    labels: TrainIds
    disagreement: Float


def label_drive(folder: Path | str, weights: Path | str | None = None) -> Iterator[FusedScan]:
    """Label the scans of a drive and fuse the labels where scans see the same places.

    That is `predict --fuse` in a temporary folder: the first scan comes when all are labelled.
    Those that cannot be are logged as errors and left out.

    Parameters
    ----------
    folder : Path or str
        Scans, and their `poses.txt`; else poses are computed, which needs ``salsanext[fuse]``.
    weights : Path or str, optional
        A weights file, None for the default weights, fitted to the scans.

    Yields
    ------
    FusedScan
        `name`, ``08/000000``, and `scan` of N points; `labels` (N,) uint8, train ids as of `label`;
        `disagreement` (N,) float32, the share of the votes against the label, NaN without any.
    """
    source = Path(folder)
    settings = NetworkSettings(weights=None if weights is None else Path(weights))
    with temporary_folder() as out:
        fused = ResultFolder(out / FUSED)
        require_fusable(source, out, RunOptions())
        outcome = predict_scans(source, out, settings=settings, extras=("votes",))
        for failure in outcome.failures:
            log.error("%s", failure.reason)
        if not outcome.done:
            raise NoInputError(source, "no scan that can be labelled", "see the errors of each")
        for reason in dict.fromkeys(failure.reason for failure in fuse_results(out).failures):
            log.error("%s", reason)
        files, space = fused.predicted(ScanSelection())
        for file in sorted(fused.with_column("label", files), key=drive_order):
            found = fused.read(file, fused.sensor())
            labels, against = np.asarray(found.label), found.uncertainty["disagreement"]
            yield FusedScan(file.name, found.scan, space.to_train(labels), against)
