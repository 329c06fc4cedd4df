# SPDX-License-Identifier: MIT
"""Stage `export-ply`: scans as coloured PLY point clouds."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats.field_names import PREFIX
from salsanext_cli.io.formats.ply import encode_ply
from salsanext_cli.report.colours import PointColours, common_scales, require_colouring
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import ExportSettings
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.paths import PREDICTION_STAGES, ScanFile
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import scalar_columns

log = logging.getLogger(__name__)


def _export_scan(
    file: ScanFile,
    colours: PointColours,
    sensor: Sensor,
    output: OutputRun,
    classes: LabelSpace | None,
    labels: LabelSpace,
) -> None:
    """Write a scan as a coloured cloud with all scalars."""
    output.require_replaceable(file)
    folder, space = ResultFolder(output.root), colours.space
    results = folder.read(file, sensor, classes, (labels, space))
    columns = scalar_columns(results, space)
    if colours.colour not in columns:
        raise folder.missing_column(colours.colour, file)
    points = dict(zip("xyz", results.scan.points.T, strict=True))
    rgb = dict(zip(("red", "green", "blue"), colours.of_points(columns).T, strict=True))
    # CloudCompare takes properties with this prefix for scalars, and shows the first.
    shown = {colours.colour: columns[colours.colour]} | columns
    named = {f"{PREFIX}{name}": values for name, values in shown.items()}
    comments = [f"colour {colours.legend}", f"label space {space.name}"]
    comments += filter(None, [results.accepted_text(space)])
    output.write(output.paths(file)[0], encode_ply(points | rgb | named, comments))


def export_ply(
    out: Path,
    *,
    colour: str = "label",
    scale: tuple[float, float] | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/ply/*.ply`: positions, colours and every known scalar.

    The first colouring of a folder goes there, further ones to `ply/<colour>/*.ply`. A continued
    run keeps its scale.

    Parameters
    ----------
    out : Path
        Folder with results.
    colour : str
        One of `COLOURS`.
    scale : tuple of float, optional
        Values at the ends of the colour map; by default the range of most values.
    query, options
        Choice of scans, data set and classes; workers and progress.

    Returns
    -------
    Outcome
    """
    require_colouring([colour], scale)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    scans, space, sensor = chosen.scans, chosen.space, results.sensor()
    if colour == "uncertainty":
        colour = results.meant_uncertainty(scans)
    results.require_column(colour, scans)
    stage = "export-ply"
    folder = "ply"
    first = _recorded(results, stage)
    if first is not None and first.colour != colour:
        # The folder has clouds in other colours, which stay.
        stage = f"export-ply-{colour}"
        folder = f"ply/{colour}"
    origins = results.origins(PREDICTION_STAGES)
    earlier = _recorded(results, stage)
    overwrite = options.overwrite or (earlier is not None and earlier.origins != origins)
    ends = scale or (earlier.scale if earlier and not overwrite else None)
    ends = ends or common_scales(out, scans, [colour], space, sensor).get(colour, (0.0, 1.0))
    settings = ExportSettings(colour=colour, scale=ends, label_space=space, origins=origins)
    run = (out, stage, settings, (folder,), scans)
    with output_run(*run, overwrite=overwrite, record_scans=False) as output:
        colours = PointColours(colour, ends, space)
        task = partial(_export_scan, colours=colours, sensor=sensor, output=output)
        task = partial(task, classes=query.classes, labels=chosen.labels)
        outcome = run_over_scans(task, scans, options, is_done=output.is_done)
    log.log(NOTICE, "coloured by %s: %s", colour, out / "sequences/*" / folder)
    return replace(outcome, missing=chosen.missing)


def _recorded(results: ResultFolder, stage: str) -> ExportSettings | None:
    """Return the settings of an earlier export, None if it did not run."""
    settings = results.settings(stage)
    return settings if isinstance(settings, ExportSettings) else None
