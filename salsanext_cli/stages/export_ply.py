# SPDX-License-Identifier: MIT
"""Stage `export-ply`: scans and results to coloured point clouds, PLY or LAS."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, UsageError
from salsanext_cli.formats.label_scalars import PREFIX
from salsanext_cli.formats.las import asprs_class, classification, encode_las, import_laspy
from salsanext_cli.formats.ply import encode_ply
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.report.colours import PointColours, common_scales, require_colouring
from salsanext_cli.results.layout import LABELLING_STAGES, ScanFile
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.result_folder import ResultFolder, scalar_columns
from salsanext_cli.results.stage_records import StageRecords
from salsanext_cli.sensors.sensor import Sensor

FORMATS = ("ply", "las", "laz")

log = logging.getLogger(__name__)


def export_scan(
    file: ScanFile,
    colours: PointColours,
    sensor: Sensor,
    form: str,
    output: OutputRun,
    classes: LabelSpace | None,
    labels: LabelSpace,
    max_error: float | None = None,
) -> int:
    """Write one scan as a coloured cloud with every known scalar; return how many are rejected."""
    output.require_replaceable(file)
    results = ResultFolder(output.root).read(file, sensor, classes, (labels, colours.space))
    if max_error is not None:
        if "error" not in results.uncertainty:
            raise ResultFolder(output.root).missing_column("error", file)
        results = results.rejecting(max_error, colours.space)
    columns = scalar_columns(results, colours.space)
    if colours.colour not in columns:
        raise ResultFolder(output.root).missing_column(colours.colour, file)
    rgb = dict(zip(("red", "green", "blue"), colours.of_points(columns).T, strict=True))
    drawn = dict(zip("xyz", results.scan.points.T, strict=True)) | rgb
    comments = [f"colour {colours.legend}", f"label space {colours.space.name}"]
    if max_error is not None:
        comments.append(f"unlabelled where error is above {max_error:g}")
    (folder,) = output.folders
    if form == "ply":
        # CloudCompare takes what is named so for scalars, and shows the first.
        shown = {colours.colour: columns[colours.colour]} | columns
        named = {f"{PREFIX}{name}": values for name, values in shown.items()}
        output.write_result(file, folder, encode_ply(drawn | named, comments))
        return results.rejected_points
    space, path = colours.space, output.path(file, folder)
    comments += [f"class {asprs_class(i, space)} {name}" for i, name in space.labels.items()]
    of_points = classification(columns.get("label", np.zeros(len(results.scan), np.uint32)), space)
    output.write_result(file, folder, encode_las(path, drawn | columns, of_points, comments))
    return results.rejected_points


def export_ply(
    out: Path,
    *,
    colour: str = "label",
    scale: tuple[float, float] | None = None,
    max_error: float | None = None,
    form: str = "ply",
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/ply/*.ply` or the like: positions, colours and every known scalar.

    The first colouring of a folder goes there, each further one to `ply/<colour>/*.ply`. Clouds of
    results that have been made anew since are replaced.

    `colour`: one of `COLOURS`; `scale`: values at the ends of the colour map, the same for all
    scans, otherwise what most points of the first scans span; `max_error`: points whose error, 0…1,
    is above it are written as unlabelled; `form`: of `FORMATS`; `space`, `classes`: as for
    `ResultFolder.predicted`.
    """
    results = ResultFolder(out, dataset)
    require_colouring([colour], scale)
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError("--max-error", f"{max_error:g}", "a probability from 0 to 1")
    if form not in FORMATS:
        raise UsageError("--format", form, f"one of {', '.join(FORMATS)}")
    if form != "ply":
        import_laspy(f"--format {form}", compressed=form == "laz")
    chosen = results.chosen(selection, space, classes)
    scans, space = chosen.scans, chosen.space
    if max_error is not None:
        results.require_column("error", scans)
    if colour == "uncertainty":
        colour = results.meant_uncertainty(scans)
    results.require_column(colour, scans)
    sensor = results.sensor()
    stage, folder = _place(out, colour, form)
    made_of, earlier = results.origins(LABELLING_STAGES), results.settings(stage)
    overwrite = options.overwrite or (earlier is not None and earlier["origins"] != made_of)
    if scale is None and earlier is not None and not overwrite:
        # A run that goes on colours alike.
        scale = earlier.pair("scale")
    if scale is None:
        scale = common_scales(out, scans, [colour], space, sensor).get(colour, (0.0, 1.0))
    settings = {
        "colour": colour,
        "scale": list(scale),
        "label_space": space.to_dict(),
        "origins": made_of,
        **({} if max_error is None else {"max_error": max_error}),
    }
    rejected = list[int]()
    colours = PointColours(colour, scale, space)
    with output_run(
        *(out, stage, settings, (folder,), scans),
        overwrite=overwrite,
        record_scans=False,
    ) as output:
        task = partial(export_scan, colours=colours, sensor=sensor, form=form, output=output)
        task = partial(task, classes=classes, labels=chosen.labels, max_error=max_error)
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, on_result=rejected.append
        )
    log.log(NOTICE, "coloured by %s: %s", colour, out / "sequences/*" / folder)
    total = None if max_error is None else sum(rejected)
    return replace(outcome, missing=chosen.missing, rejected_points=total)


def _place(out: Path, colour: str, form: str) -> tuple[str, str]:
    """Return the name of the record of a colouring, and the folder for its clouds."""
    first = StageRecords(out).settings("export-ply")
    if first is None or first["colour"] == colour:
        return "export-ply", form
    return f"export-ply-{colour}", f"{form}/{colour}"
