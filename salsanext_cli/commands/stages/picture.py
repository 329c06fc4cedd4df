# SPDX-License-Identifier: MIT
"""Stage `picture`: pictures of scans and results."""

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.io.sensors import sensor
from salsanext_cli.report.colours import CLASS_COLOURS, Scales, common_scales, require_colouring
from salsanext_cli.report.scan_pictures import known_views, picture_of_results
from salsanext_cli.runs.fit.sensor_fit import fitted_view
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import PictureSettings
from salsanext_cli.runs.results.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.paths import COLOURINGS, PREDICTION_STAGES, ScanFile
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder
from salsanext_cli.runs.results.scan_results import scalar_columns

STAGE: Final = "picture"
FOLDER = "pictures"

log = logging.getLogger(__name__)


def _picture_scan(
    file: ScanFile,
    colours: Sequence[str],
    scales: Scales,
    space: LabelSpace,
    sensor: Sensor,
    output: OutputRun,
    classes: LabelSpace | None,
    truth_in: tuple[LabelSpace, LabelSpace] | None,
) -> None:
    """Write the picture of one scan in some colours, or in all colours that it has."""
    output.require_replaceable(file)
    results = ResultFolder(output.root).read(file, sensor, classes, truth_in)
    columns = scalar_columns(results, space)
    for colour in colours:
        if colour not in columns:
            raise ResultFolder(output.root).missing_column(colour, file)
    views = colours or known_views(columns)
    strips = colours or [colour for colour in COLOURINGS if colour in columns]
    png = picture_of_results(file.name, results, space, sensor, scales, views, strips)
    output.write(output.path(file, FOLDER), png)


def _shows_truth(chosen: ChosenResults, colours: Collection[str], sensor: Sensor) -> bool:
    """Return whether pictures need the true labels: if asked for, or if there are usable ones."""
    if colours:
        return bool({"truth", "wrong"} & {*colours})
    return not warn_of_foreign_labels(chosen.scans, chosen.labels, sensor)


def picture(
    out: Path,
    *,
    colours: Collection[str] = (),
    scale: tuple[float, float] | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/pictures/*.png`.

    Parameters
    ----------
    out : Path
        Folder with results.
    colours : collection of str
        Some of `COLOURS`; by default every colour that a scan has.
    scale : tuple of float, optional
        Values at the ends of the colour map, for a single colour.
    query, options
        Choice of scans, data set and classes; workers and progress.

    Returns
    -------
    Outcome
    """
    require_colouring(colours, scale, "colours")
    if scale and (len(colours) != 1 or {*colours} & {*CLASS_COLOURS}):
        problem = f"{argument('colours')} is {', '.join(colours) or 'missing'}"
        raise UsageError(argument("scale"), problem, "a single colour of values, such as error")
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    scans, space = chosen.scans, chosen.space
    meant = {"uncertainty": results.meant_uncertainty(scans)}
    colours = list(dict.fromkeys(meant.get(colour, colour) for colour in colours))
    for colour in colours:
        results.require_column(colour, scans)
    origins = results.origins(PREDICTION_STAGES)
    earlier = results.settings(STAGE)
    overwrite = options.overwrite or (earlier is not None and earlier.origins != origins)
    continued = None if overwrite else earlier  # Keeps sensor and scales
    view = results.known_sensor() or (continued.sensor if continued else None)
    view = view or fitted_view(scans, sensor("hdl64"))
    values = [c for c in colours or COLOURINGS if c not in CLASS_COLOURS]
    values = [colour for colour in values if results.with_column(colour, scans)]
    known = (continued and continued.scales) or {}
    scales: Scales = dict.fromkeys(values, scale) if scale else dict(known)
    unknown = [colour for colour in values if colour not in scales]
    scales |= common_scales(out, scans, unknown, space, view)
    settings = PictureSettings(
        colours=tuple(colours), scales=scales, sensor=view, label_space=space, origins=origins
    )
    truth_in = (chosen.labels, space) if _shows_truth(chosen, colours, view) else None
    run = (out, STAGE, settings, (FOLDER,), scans)
    with output_run(*run, overwrite=overwrite, record_scans=False) as output:
        task = partial(_picture_scan, colours=colours, scales=scales, space=space, sensor=view)
        task = partial(task, output=output, classes=query.classes, truth_in=truth_in)
        outcome = run_over_scans(task, scans, options, is_done=output.is_done)
        log.log(NOTICE, "pictures: %s", out / "sequences/*" / FOLDER)
    return replace(outcome, missing=chosen.missing)
