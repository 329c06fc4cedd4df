# SPDX-License-Identifier: MIT
"""Stage `uncertainty`: scans to labels and uncertainties of their points."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, OutputError
from salsanext_cli.fitting.label_scan import labelled, project_for
from salsanext_cli.fitting.scan_fit import network_of_run, settings_of_network
from salsanext_cli.geometry.network_input import noise_of
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.options import KnnParameters, ScanSelection
from salsanext_cli.parallel.run import NetworkTask, Outcome, RunOptions, ScanSteps, run_over_scans
from salsanext_cli.results.layout import ERROR, ScanFile
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.provenance import Provenance
from salsanext_cli.results.selection import choose, scans_of, space_of
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.uncertainty.error_features import error_probability, knows_error
from salsanext_cli.uncertainty.method import UncertaintyMethod

log = logging.getLogger(__name__)


def uncertainty_scan(
    file: ScanFile,
    network: Network,
    knn: KnnParameters,
    method: UncertaintyMethod,
    output: OutputRun,
) -> ScanSteps:
    """Estimate the uncertainty of one scan's points, in steps; the last yields numbers about it."""
    output.require_replaceable(file)
    network, projected = project_for(network, file)
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
        output.write_array(file, ERROR, error_probability(network, image, single, labels))
    output.write_labels(file, space.to_raw(labels))
    yield ScanSummary.of_labels(file, labels, space, check)


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
    """
    network = settings.load()
    listed = scans_of(source)
    scans = choose(listed, selection, space_of(listed, network.card.space), source)
    # Labels of another stage stay, and with them what they were made with.
    labels_too = Provenance(out).owner("predictions") in (None, "uncertainty")
    overwrite = options.overwrite and labels_too
    network = network_of_run(settings, network, listed, out, overwrite=overwrite)
    method.require(network)
    recorded = replace(
        settings_of_network(network),
        knn=knn,
        method=method.method,
        aleatoric=method.aleatoric,
        samples=method.samples if method.is_sampled else None,
        seed=method.seed if method.is_random else None,
        noise=noise_of(network.sensor) if method.is_noisy else None,
    )
    kinds = tuple(f"uncertainty/{kind}" for kind in method.kinds)
    folders = (*kinds, "predictions") if labels_too else kinds
    if knows_error(network) and labels_too:
        folders = (ERROR, *folders)
    elif knows_error(network) and Provenance(out).owner(ERROR) is None:
        log.log(NOTICE, "no errors: the labels in %s are another stage's; see predict --error", out)
    _require_network_of_labels(out, recorded)
    summary = RunSummary.of_scans(scans, network.sensor, network.space)
    run = output_run(out, "uncertainty", recorded, folders, scans, overwrite=options.overwrite)
    with run as output, summary.kept_in(output, scans):
        function = partial(uncertainty_scan, knn=knn, method=method, output=output)
        task = NetworkTask(function, settings.resolved(network), network)
        return run_over_scans(task, scans, options, is_done=output.is_done, summary=summary)


def _require_network_of_labels(out: Path, settings: StageSettings) -> None:
    """Refuse to put the uncertainty of one network beside the labels of another."""
    records = Provenance(out)
    stage = records.owner("predictions")
    recorded = records.settings(stage) if stage not in (None, "uncertainty") else None
    if recorded is None or stage is None:
        return
    before, now = (
        each.sensor and replace(each.sensor.without_noise(), name="")
        for each in (recorded, settings)
    )
    same = {"sensor": before in (None, now)}
    # Labels of other programs may be in any classes.
    if (weights := records.weights("predictions")) and settings.label_space:
        space = records.label_space("predictions")
        same["weights"] = weights == settings.weights
        same["classes"] = space is not None and space.fits(settings.label_space)
    for name in (name for name, is_same in same.items() if not is_same):
        found, expected = f"labels made with other {name}", "the same for labels and uncertainty"
        remedy = f"give the same --{name}, or use another output folder"
        raise OutputError(records.path(stage), found, expected, remedy)
