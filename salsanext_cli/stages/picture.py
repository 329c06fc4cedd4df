# SPDX-License-Identifier: MIT
"""Stage `picture`: scans and results to pictures."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, NoInputError, UsageError
from salsanext_cli.fitting.sensor_fit import fitted_view
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.report.colours import CLASS_COLOURS, Scales, common_scales, require_colouring
from salsanext_cli.report.scan_pictures import known_views, picture_of_results
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.paths import (
    COLOURINGS,
    PREDICTION_STAGES,
    SUFFIX_OF_FOLDER,
    ScanFile,
    find_outputs,
)
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import FOLDERS, ChosenResults, ResultFolder, scalar_columns
from salsanext_cli.results.selection import MissingResults, choose, scans_of, space_of_labels
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor, sensor

STAGE, FOLDER = "picture", "pictures"

log = logging.getLogger(__name__)


def picture_scan(
    file: ScanFile,
    colours: Sequence[str],
    scales: Scales,
    space: LabelSpace,
    sensor: Sensor,
    output: OutputRun,
    classes: LabelSpace | None,
    labels: LabelSpace,
) -> None:
    """Write the picture of one scan: of some colours, or of all that is known of it."""
    output.require_replaceable(file)
    shows_truth = not colours or {"truth", "wrong"} & {*colours}
    truth_in = (labels, space) if shows_truth else None
    results = ResultFolder(output.root).read(file, sensor, classes, truth_in)
    columns = scalar_columns(results, space)
    for colour in colours:
        if colour not in columns:
            raise ResultFolder(output.root).missing_column(colour, file)
    views = colours or known_views(columns)
    strips = colours or [colour for colour in COLOURINGS if colour in columns]
    png = picture_of_results(file.name, results, space, sensor, scales, views, strips)
    output.write(output.path(file, FOLDER), png)


def picture(
    out: Path,
    *,
    colours: Collection[str] = (),
    scale: tuple[float, float] | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/pictures/*.png`.

    Pictures of results that have been made anew since are replaced. Without any results, pictures
    are of the scans of `dataset` alone.
    """
    results = ResultFolder(out, query.dataset)
    require_colouring(colours, scale)
    if scale and (len(colours) != 1 or {*colours} & {*CLASS_COLOURS}):
        found = ", ".join(colours) or "none"
        raise UsageError("--scale", f"--colour is {found}", "one that shows values")
    has_results = any(find_outputs(out, folder) for folder in FOLDERS)
    chosen = results.chosen(query) if has_results else _scans_alone(out, query)
    scans, space = chosen.scans, chosen.space
    meant = {"uncertainty": results.meant_uncertainty(scans)}
    colours = list(dict.fromkeys(meant.get(colour, colour) for colour in colours))
    for colour in colours:
        results.require_column(colour, scans)
    made_of, earlier = results.origins(PREDICTION_STAGES), results.settings(STAGE)
    overwrite = options.overwrite or (earlier is not None and earlier.origins != made_of)
    going_on = None if overwrite else earlier
    seen = results.known_sensor() or (going_on.sensor if going_on else None)
    seen = seen or fitted_view(scans, sensor("hdl64"))
    values = [c for c in colours or COLOURINGS if c not in CLASS_COLOURS]
    values = [colour for colour in values if results.with_column(colour, scans)]
    scales: Scales = dict.fromkeys(values, scale) if scale else {}
    if not scale:
        # A run that goes on colours alike.
        scales = dict((going_on.scales if going_on else None) or {})
        unknown = [colour for colour in values if colour not in scales]
        scales |= common_scales(out, scans, unknown, space, seen)
    settings = StageSettings(
        colours=tuple(colours), scales=scales, sensor=seen, label_space=space, origins=made_of
    )
    with output_run(
        *(out, STAGE, settings, (FOLDER,), scans), overwrite=overwrite, record_scans=not has_results
    ) as output:
        task = partial(picture_scan, colours=colours, scales=scales, space=space, sensor=seen)
        task = partial(task, output=output, classes=query.classes, labels=chosen.labels)
        outcome = run_over_scans(task, scans, options, is_done=output.is_done)
        log.log(NOTICE, "pictures: %s", out / "sequences/*" / FOLDER)
    return replace(outcome, missing=chosen.missing)


def _scans_alone(out: Path, query: ResultQuery) -> ChosenResults:
    """Choose among the scans of a data set, or of what else a folder holds, without any labels."""
    results, dataset = ResultFolder(out), query.dataset
    if dataset is None and not any(find_outputs(out, folder) for folder in SUFFIX_OF_FOLDER):
        found = "holds no results" if out.is_dir() else "no such folder"
        hint = f"run `salsanext predict SCANS {out}` first, or name scans with --dataset"
        raise NoInputError(out, found, "the output folder of an earlier stage", hint)
    found_scans = scans_of(dataset) if dataset else results.scans()
    own, classes = query.label_space, query.classes
    space = results.compared_space(found_scans, own, classes, other_ids=True)
    scans = choose(found_scans, query.selection, space, dataset or out)
    labels = space_of_labels(found_scans, space, own)
    return ChosenResults(scans, space, labels, MissingResults())
