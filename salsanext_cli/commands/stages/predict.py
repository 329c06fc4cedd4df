# SPDX-License-Identifier: MIT
"""Stage `predict`: scans to labels, or range images on disk to pixel labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from salsanext_cli.commands.jobs.image_job import PredictImageJob
from salsanext_cli.commands.jobs.plans.prediction_plan import PreparedPrediction, prepare_prediction
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.commands.jobs.predict_job import PredictJob
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.records import Origin
from salsanext_cli.runs.fit.range_images import projected_sensor, range_image, sensor_of_images
from salsanext_cli.runs.fit.sensor_fit import (
    fitted_members,
    network_of_run,
    resolved_for,
    settings_of_network,
)
from salsanext_cli.runs.loop.network_task import NetworkTask
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings
from salsanext_cli.runs.results.output_paths import with_outputs
from salsanext_cli.runs.results.output_run import output_run
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, space_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.run_summary import RunSummary

__all__ = [
    "PredictJob",
    "PredictOutcome",
    "plan_prediction",
    "predict_range_images",
    "predict_scans",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictOutcome(Outcome):
    """Numbers of a prediction."""

    # Number of points that were left unlabelled by their uncertainty; None without a limit
    rejected_points: int | None = None
    has_int8_ranges: bool = False  # Whether the weights can compute in int8


def predict_scans(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    extras: tuple[str, ...] = (),
    reject: float | Literal["risk"] | None = None,
    batch: int | None = None,
    origin: Origin | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> PredictOutcome:
    """Label scans into `OUT/sequences/<seq>/predictions`, with their least confidence.

    Parameters
    ----------
    source : Path or sequence of Path
        Scan files, a folder of scans, a sequence or a data set.
    out : Path
        Output folder.
    settings : NetworkSettings, optional
        Weights, device and sensor of the network; by default those of the package.
    knn : KnnParameters, optional
        Neighbourhood of the vote; the published one by default.
    extras : tuple of str
        Further results: pixel_labels, probabilities, votes, objects, uncertainty/error.
    reject : float or "risk", optional
        Probability of error above which points become unlabelled, or the threshold in the weights.
    batch : int, optional
        Number of scans that are computed together; by default chosen for the device.
    origin : 3 floats, optional
        Position of the sensor in the coordinates of the files, in metres.
    selection : ScanSelection, optional
        Choice of the scans; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    PredictOutcome
    """
    prepared = prepare_prediction(
        source,
        out,
        settings=settings,
        knn=knn,
        extras=extras,
        reject=reject,
        batch=batch,
        origin=origin,
        selection=selection,
        overwrite=options.overwrite,
    )
    network = prepared.network
    scans = prepared.scans
    rejection = prepared.rejection
    summary = _new_summary(prepared)
    with prepared.opened() as output, recorded_summary(summary, output, scans):
        by_poses = prepared.origins.result_origins(output, scans, network.sensor)
        job = partial(PredictJob, knn=knn, output=output, reject=rejection, origins=by_poses)
        task = NetworkTask(
            job=job,
            settings=resolved_for(prepared.settings, network, scans),
            network=network,
            batch=batch,
        )
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, summary=summary, writes=[out]
        )
    rejected_points = summary.counts.rejected_points if rejection else None
    return PredictOutcome.from_run(
        outcome, rejected_points=rejected_points, has_int8_ranges=bool(network.card.int8)
    )


def plan_prediction(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    extras: tuple[str, ...] = (),
    reject: float | Literal["risk"] | None = None,
    origin: Origin | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `predict_scans` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    source, out, settings, knn, extras, reject, origin, selection, options
        As for `predict_scans`.

    Returns
    -------
    RunPlan
        Scans, size of the results, and the sensor, whose fit to the scans is that of the run.

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    prepared = prepare_prediction(
        source,
        out,
        settings=settings,
        knn=knn,
        extras=extras,
        reject=reject,
        origin=origin,
        selection=selection,
        overwrite=options.overwrite,
    )
    return RunPlan.from_network_run(prepared, options.shard)


def _new_summary(prepared: PreparedPrediction) -> RunSummary:
    """Return the summary of a run without any scan yet."""
    threshold = prepared.rejection.risk if prepared.rejection else None
    accuracy = prepared.recorded.accuracy
    return RunSummary.from_network(prepared.network, prepared.scans, accuracy, threshold)


def predict_range_images(
    folder: Path,
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> PredictOutcome:
    """Label range images of `project` into `OUT/sequences/<seq>/pixel_labels`.

    Parameters
    ----------
    folder : Path
        Output folder of `project`.
    out : Path
        Output folder, which may be the same.
    settings : NetworkSettings, optional
        Weights, device and sensor of the network; by default those of the package.
    selection : ScanSelection, optional
        Choice of the scans; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    PredictOutcome
    """
    network = settings.load()
    projected = projected_sensor(folder)
    fitted = fitted_members(
        [], network.sensor, projected, view=settings.fits_view, mounting=settings.fits_mounting
    )
    network = network.for_sensor(sensor_of_images(folder, projected, fitted))
    listed = with_outputs(ResultFolder(folder).scans(), folder, "range")
    scans = choose(listed, selection, space_of(listed, network.card.space), folder)
    network = network_of_run(
        settings,
        network,
        listed,
        out,
        overwrite=options.overwrite,
        image_of=partial(range_image, folder=folder, sensor=network.sensor),
        origins_of=OriginsOfRun(out=folder, stage="predict", listed=listed).sample_origins,
    )
    summary = RunSummary(sensor=network.sensor, trained=network.card.sensor)
    opening = output_run(
        out,
        "predict",
        settings_of_network(network, PredictSettings),
        ("pixel_labels",),
        scans,
        overwrite=options.overwrite,
        weights=settings.named_path,
        options=settings.named(),
    )
    with opening as output, recorded_summary(summary, output, scans):
        job = partial(PredictImageJob, folder=folder, output=output)
        task = NetworkTask(job=job, settings=settings.resolved(network), network=network)
        outcome = run_over_scans(
            task,
            scans,
            options,
            is_done=output.is_done,
            summary=summary,
            writes=[out],
            reads=[folder],
        )
    return PredictOutcome.from_run(outcome, has_int8_ranges=bool(network.card.int8))
