# SPDX-License-Identifier: MIT
"""Stage `uncertainty`: scans to labels and uncertainties of their points."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from salsanext_cli.commands.jobs.plans.prepared_run import PreparedNetworkRun
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.commands.jobs.uncertainty_job import UncertaintyJob
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.uncertainty.error_features import knows_error
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.runs.fit.sensor_fit import (
    is_unreadable,
    network_of_run,
    resolved_for,
    settings_of_network,
)
from salsanext_cli.runs.loop.job_memory import FILTERED, SAMPLES
from salsanext_cli.runs.loop.network_task import sampling_task
from salsanext_cli.runs.loop.recorded_names import with_recorded_names
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import StageSettings, UncertaintySettings
from salsanext_cli.runs.results.folder_names import ERROR
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.recorded_origins import folders_of_origins
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, scans_of, space_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.run_summary import RunSummary

METHOD = "sampling"  # Recorded, because earlier versions had another method

log = logging.getLogger(__name__)


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
    source : Path or sequence of Path
        Scan files, a folder of scans, a sequence or a data set.
    out : Path
        Output folder.
    settings : NetworkSettings, optional
        Weights, device and sensor of the network; by default those of the package.
    knn : KnnParameters, optional
        Neighbourhood of the vote; the published one by default.
    method : UncertaintyMethod, optional
        Kinds of uncertainty, and number of passes.
    selection : ScanSelection, optional
        Choice of the scans; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    Outcome
    """
    prepared = _prepared(
        source,
        out,
        settings=settings,
        knn=knn,
        method=method,
        selection=selection,
        overwrite=options.overwrite,
    )
    network = prepared.network
    scans = prepared.scans
    summary = RunSummary.from_network(network, scans)
    with prepared.opened() as output, recorded_summary(summary, output, scans):
        by_poses = prepared.origins.result_origins(output, scans, network.sensor)
        job = partial(UncertaintyJob, knn=knn, method=method, output=output, origins=by_poses)
        resolved = resolved_for(settings, network, scans)
        if not is_unreadable(scans, network):
            log.log(NOTICE, "each scan takes %s", method.passes_text)
        memory = FILTERED if method.aleatoric == "paper" else SAMPLES
        task = sampling_task(job, resolved, network, memory)
        return run_over_scans(
            task, scans, options, is_done=output.is_done, summary=summary, writes=[out]
        )


def plan_uncertainty(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    method: UncertaintyMethod = UncertaintyMethod(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `uncertainty` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    source, out, settings, knn, method, selection, options
        As for `uncertainty`.

    Returns
    -------
    RunPlan
        Scans, size of the results, and the sensor, whose fit to the scans is that of the run.

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    prepared = _prepared(
        source,
        out,
        settings=settings,
        knn=knn,
        method=method,
        selection=selection,
        overwrite=options.overwrite,
    )
    return RunPlan.from_network_run(prepared, options.shard)


def _prepared(
    source: Path | Sequence[Path],
    out: Path,
    *,
    settings: NetworkSettings,
    knn: KnnParameters,
    method: UncertaintyMethod,
    selection: ScanSelection,
    overwrite: bool,
) -> PreparedNetworkRun:
    """Load and fit the network, and find the scans; arguments as of `uncertainty`."""
    network = settings.for_sampling().load()
    listed = with_recorded_names(scans_of(source), out)
    scans = choose(listed, selection, space_of(listed, network.card.space), source)
    # Labels of another stage stay, and so must the sensor with which they were made.
    labels_too = Manifest(out).owner("predictions") in (None, "uncertainty")
    origins = OriginsOfRun(out=out, stage="uncertainty", listed=listed, overwrite=overwrite)
    network = network_of_run(
        settings,
        network,
        listed,
        out,
        overwrite=overwrite and labels_too,
        origins_of=origins.sample_origins,
    )
    method.require(network)
    noise = network.sensor.require_noise() if method.is_noisy else None
    recorded = replace(
        settings_of_network(network, UncertaintySettings),
        knn=knn,
        method=METHOD,
        aleatoric=method.aleatoric,
        samples=method.samples,
        seed=method.seed,
        noise=(noise.range, noise.intensity) if noise else None,
    )
    folders = _folders(out, network, method, labels_too=labels_too)
    _require_network_of_labels(out, recorded)
    return PreparedNetworkRun(
        out=out,
        stage="uncertainty",
        listed=listed,
        scans=scans,
        recorded=recorded,
        folders=folders,
        overwrite=overwrite,
        weights=settings.named_path,
        options=settings.named(),
        network=network,
        origins=origins,
    )


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
    if stage is None or stage == "uncertainty":
        return
    recorded = records.settings(stage)
    if recorded is None:
        return
    difference = _difference_of_labels(Provenance(out), recorded, settings)
    if difference is not None:
        problem = f"the labels were made with other {difference}"
        hint = f"use the same {argument(difference)}, or another output folder"
        raise OutputError(records.path(stage), problem, hint=hint)


def _difference_of_labels(
    provenance: Provenance, recorded: StageSettings, settings: UncertaintySettings
) -> str | None:
    """Return the name of the argument by which labels differ from those of the settings, if any."""
    if recorded.sensor is not None and not _is_same_sensor(recorded.sensor, settings.sensor):
        return "sensor"
    weights = provenance.weights("predictions")
    if not weights or settings.label_space is None:
        # Labels of other programs may be in any classes.
        return None
    if weights != settings.weights:
        return "weights"
    space = provenance.label_space("predictions")
    if space is None or not space.fits(settings.label_space):
        return "classes"
    return None


def _is_same_sensor(sensor: Sensor, other: Sensor | None) -> bool:
    """Return whether two sensors are the same but for their noise and name."""
    if other is None:
        return False
    unnamed = replace(sensor.without_noise(), name="")
    return unnamed == replace(other.without_noise(), name="")
