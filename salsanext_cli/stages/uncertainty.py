# SPDX-License-Identifier: MIT
"""Stage `uncertainty`: scans to labels and uncertainties of their points."""

import logging
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, UsageError, counted
from salsanext_cli.fitting.label_scan import labelled, project_for
from salsanext_cli.fitting.recorded_network import network_of_labels, require_network_of_labels
from salsanext_cli.fitting.scan_fit import network_of_run
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.options import KnnParameters, ScanSelection
from salsanext_cli.parallel.run import (
    Failure,
    NetworkTask,
    Outcome,
    RunOptions,
    Steps,
    run_over_scans,
)
from salsanext_cli.results.layout import ERROR, ScanFile
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import choose, scans_of, space_of
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.uncertainty.error_features import knows_error, label_error
from salsanext_cli.uncertainty.method import (
    UncertaintyMethod,
    possible_method,
    recorded_knn,
    recorded_method,
)

log = logging.getLogger(__name__)


def uncertainty_scan(
    file: ScanFile,
    network: Network,
    knn: KnnParameters,
    method: UncertaintyMethod,
    output: OutputRun,
) -> Steps:
    """Estimate the uncertainty of one scan's points, in steps; the last yields numbers about it."""
    output.require_replaceable(file)
    projected = project_for(network, file)
    image, check = projected.image, projected.check
    yield
    estimate = method.estimate(network, image, file)
    network.engine.require_finite(estimate.probabilities, file.path)
    # The model of errors was fitted to a single pass.
    single = network.probabilities(image, file.path) if ERROR in output.folders else None
    yield
    for kind in method.kinds:
        of_pixels = getattr(estimate.uncertainty, kind)
        of_points = points_from_pixels(of_pixels, image.pixel_of_point, np.nan)
        output.write_array(file, f"uncertainty/{kind}", of_points)
    if "predictions" not in output.folders:
        yield ScanSummary(file, check)
        return
    labels, space = labelled(projected, estimate.probabilities, network, knn).labels, network.space
    if single is not None:
        output.write_array(file, ERROR, label_error(network, image, single, labels))
    output.write_labels(file, space.to_raw(labels))
    yield ScanSummary.of_labels(file, labels, space, check)


def uncertainty(
    source: Path,
    out: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    knn: KnnParameters = KnnParameters(),
    method: UncertaintyMethod = UncertaintyMethod(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Estimate uncertainty into `OUT/sequences/<seq>/uncertainty/<kind>`.

    The labels of the mean softmax go to `predictions`, unless another stage keeps its
    labels there already: those stay.
    """
    loaded = network.load()
    found = scans_of(source)
    scans = choose(found, selection, space_of(found, loaded.card.space), source)
    # Labels of another stage stay, and with them what they were made with.
    overwrite = options.overwrite and _owns_labels(out)
    network, loaded = network_of_run(network, loaded, found, out, overwrite=overwrite)
    return uncertainty_of(scans, out, network, options, loaded, knn=knn, method=method)


def uncertainty_of(
    scans: list[ScanFile],
    out: Path,
    network: NetworkSettings,
    options: RunOptions,
    loaded: Network,
    *,
    knn: KnnParameters = KnnParameters(),
    method: UncertaintyMethod = UncertaintyMethod(),
    record_scans: bool = True,
) -> Outcome:
    """Do what `uncertainty` does to scans already chosen, with a network already loaded."""
    method.require(loaded)
    settings = network.record(loaded) | {"knn": asdict(knn)} | method.settings(loaded.sensor)
    kinds = tuple(f"uncertainty/{kind}" for kind in method.kinds)
    labels_too = _owns_labels(out)
    folders = (*kinds, "predictions") if labels_too else kinds
    if knows_error(loaded) and labels_too:
        folders = (ERROR, *folders)
    elif knows_error(loaded) and StageRecords(out).owner(ERROR) is None:
        log.log(NOTICE, "no errors: the labels in %s are another stage's; see predict --error", out)
    require_network_of_labels(out, settings)
    summary = RunSummary.of_scans(scans, loaded.sensor, loaded.space)
    run = output_run(
        *(out, "uncertainty", settings, folders, scans),
        overwrite=options.overwrite,
        record_scans=record_scans,
    )
    with run as output, summary.kept_in(output, scans):
        function = partial(uncertainty_scan, knn=knn, method=method, output=output)
        task = NetworkTask(function, network.resolved(loaded), loaded)
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, on_result=summary.add
        )
    return replace(outcome, summary=summary)


def _owns_labels(out: Path) -> bool:
    """Say whether labels in a folder are, or will be, those of this stage."""
    return StageRecords(out).owner("predictions") in (None, "uncertainty")


def estimate_missing(
    out: Path, scans: list[ScanFile], colour: str, network: NetworkSettings, options: RunOptions
) -> tuple[str, dict[ScanFile, Failure]]:
    """Estimate the uncertainty of scans that lack it, as that of the others was estimated.

    Returns the kind that the colour means, and the scans whose uncertainty could not be estimated,
    and why. "uncertainty" is the error where all scans have it, else the entropy. Shards take what
    is there. An error is estimated only for scans that a run of `uncertainty` left out.
    """
    results = ResultFolder(out)
    earlier = results.settings("uncertainty")
    kind = results.meant_uncertainty(scans) if colour == "uncertainty" else colour
    known = set(results.with_column(kind, scans))
    missing = [scan for scan in scans if scan not in known]
    some = colour != "uncertainty" or len(missing) < len(scans)
    if not missing or (options.shard.count > 1 and some):
        # Shards begin at different times: they would not agree on which scans lack it.
        return kind, {}
    if kind == "error" and results.owner(ERROR) != "uncertainty":
        return kind, {}
    if options.shard.count > 1:
        found = f"no uncertainty in {out} yet"
        remedy = f"run `salsanext uncertainty SCANS {out}` first, with shards too"
        raise UsageError(f"--shard {options.shard}", found, "that of all scans", remedy)
    network = network_of_labels(out, network)
    network, loaded = network_of_run(network, network.load(), scans, out)
    method = recorded_method(earlier) if earlier else possible_method(colour, loaded.sensor)
    if kind not in ("error", *method.kinds):
        remedy = f"run `salsanext uncertainty SCANS {out} --overwrite`"
        raise UsageError(out, "uncertainty estimated without aleatoric", kind, remedy)
    log.warning("no uncertainty of %s yet: estimating it", counted(len(missing), "scan"))
    outcome = uncertainty_of(
        missing,
        out,
        network,
        replace(options, overwrite=False),
        loaded,
        knn=KnnParameters() if earlier is None else recorded_knn(earlier.table("knn")),
        method=method,
        record_scans=False,
    )
    kind = results.meant_uncertainty(scans) if colour == "uncertainty" else kind
    return kind, {failure.scan: failure for failure in outcome.failures}
