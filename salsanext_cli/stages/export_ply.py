# SPDX-License-Identifier: MIT
"""Stage `export-ply`: scans, and maps of drives, as coloured PLY point clouds."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, UsageError, counted
from salsanext_cli.formats.label_scalars import PREFIX
from salsanext_cli.formats.ply import encode_ply
from salsanext_cli.fusion.drive_map import (
    MERGED_POINTS,
    Columns,
    MapTask,
    drive_of_map,
    one_per_voxel,
)
from salsanext_cli.fusion.window import require_near
from salsanext_cli.option_fields import FusionReach
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.report.colours import PointColours, Scale, common_scales, require_colouring
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import PREDICTION_STAGES, ScanFile, drive_order
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ChosenResults, ResultFolder, scalar_columns
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import Sensor

MIN_VOXEL_M, MAX_VOXEL_M = 0.01, 10.0

log = logging.getLogger(__name__)


def _export_scan(
    file: ScanFile,
    colours: PointColours,
    sensor: Sensor,
    output: OutputRun,
    classes: LabelSpace | None,
    labels: LabelSpace,
    max_error: float | None = None,
) -> int:
    """Write a scan as a coloured cloud with all scalars; return the number of rejected points."""
    output.require_replaceable(file)
    results = ResultFolder(output.root).read(file, sensor, classes, (labels, colours.space))
    if max_error is not None:
        if "error" not in results.uncertainty:
            raise ResultFolder(output.root).missing_column("error", file)
        results = results.rejecting(max_error, colours.space)
    columns = scalar_columns(results, colours.space)
    if colours.colour not in columns:
        raise ResultFolder(output.root).missing_column(colours.colour, file)
    (folder,), points = output.folders, dict(zip("xyz", results.scan.points.T, strict=True))
    comments = [] if max_error is None else [f"unlabelled where error is above {max_error:g}"]
    comments += [text] if (text := results.accepted_text(colours.space)) else []
    cloud = _encode_cloud(points, columns, colours, comments)
    output.write(output.path(file, folder), cloud)
    return 0 if results.rejected is None else int(results.rejected.sum())


def _encode_cloud(
    points: Columns, columns: Columns, colours: PointColours, notes: Sequence[str] = ()
) -> bytes:
    """Return a coloured PLY cloud of `points`, x, y, z, and scalars."""
    rgb = dict(zip(("red", "green", "blue"), colours.of_points(columns).T, strict=True))
    comments = [f"colour {colours.legend}", f"label space {colours.space.name}", *notes]
    # CloudCompare takes properties with this prefix for scalars, and shows the first.
    shown = {colours.colour: columns[colours.colour]} | columns
    named = {f"{PREFIX}{name}": values for name, values in shown.items()}
    return encode_ply(points | rgb | named, comments)


def export_ply(
    out: Path,
    *,
    colour: str = "label",
    scale: tuple[float, float] | None = None,
    max_error: float | None = None,
    voxel: float | None = None,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/ply/*.ply`: positions, colours and every known scalar.

    The first colouring of a folder goes there, further ones to `ply/<colour>/*.ply`, and maps of
    drives to `OUT/sequences/<seq>/map.ply`.

    Parameters
    ----------
    out : Path
        Folder with results.
    colour : str
        One of `COLOURS`.
    scale : tuple of float, optional
        Values at the ends of the colour map.
    max_error : float, optional
        Probability of error, 0…1, above which points become unlabelled.
    voxel : float, optional
        Edge of the voxels of a map in metres; writes maps of fused drives instead of scans.
    query, options
        Choice of scans, data set and classes; workers and progress.

    Returns
    -------
    Outcome
        Numbers of written and skipped scans and of rejected points, and the failures.
    """
    _require_options(colour, scale, max_error)
    if voxel is not None:
        if max_error is not None or options.shard.count > 1 or colour in ("truth", "wrong"):
            problem = "does not work with --max-error, --shard or colours of the truth"
            raise UsageError("--map", problem)
        if not MIN_VOXEL_M <= voxel <= MAX_VOXEL_M:
            raise UsageError("--map-voxel", f"{voxel:g}", f"{MIN_VOXEL_M} to {MAX_VOXEL_M} metres")
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    if max_error is not None:
        results.require_column("error", chosen.scans)
    if colour == "uncertainty":
        colour = results.meant_uncertainty(chosen.scans)
    results.require_column(colour, chosen.scans)
    if voxel is not None:
        return _export_maps(results, chosen, colour, scale, voxel, options)
    return _export_scans(results, chosen, colour, scale, max_error, query.classes, options)


def _require_options(
    colour: str, scale: tuple[float, float] | None, max_error: float | None
) -> None:
    require_colouring([colour], scale)
    if max_error is not None and not 0 <= max_error <= 1:
        raise UsageError("--max-error", f"{max_error:g}", "a probability from 0 to 1")


def _point_colours(
    results: ResultFolder, chosen: ChosenResults, colour: str, scale: Scale | None
) -> PointColours:
    """Return the colouring on a scale, by default the range of most values."""
    if scale is None:
        args = (results.root, chosen.scans, [colour], chosen.space, results.sensor())
        scale = common_scales(*args).get(colour, (0.0, 1.0))
    return PointColours(colour, scale, chosen.space)


def _export_scans(
    results: ResultFolder,
    chosen: ChosenResults,
    colour: str,
    scale: Scale | None,
    max_error: float | None,
    classes: LabelSpace | None,
    options: RunOptions,
) -> Outcome:
    """Write the clouds of scans; a continued run keeps its scale."""
    out, scans = results.root, chosen.scans
    stage, folder = _stage_and_folder(out, colour)
    origins, earlier = results.origins(PREDICTION_STAGES), results.settings(stage)
    overwrite = options.overwrite or (earlier is not None and earlier.origins != origins)
    if scale is None and earlier and not overwrite:
        scale = earlier.scale
    colours = _point_colours(results, chosen, colour, scale)
    settings = StageSettings(
        colour=colour,
        scale=colours.scale,
        label_space=chosen.space,
        origins=origins,
        max_error=max_error,
    )
    rejected, run = list[int](), (out, stage, settings, (folder,), scans)
    with output_run(*run, overwrite=overwrite, record_scans=False) as output:
        task = partial(_export_scan, colours=colours, sensor=results.sensor(), output=output)
        task = partial(task, classes=classes, labels=chosen.labels, max_error=max_error)
        outcome = run_over_scans(
            task, scans, options, is_done=output.is_done, on_result=rejected.append
        )
    log.log(NOTICE, "coloured by %s: %s", colour, out / "sequences/*" / folder)
    total = None if max_error is None else sum(rejected)
    return replace(outcome, missing=chosen.missing, rejected_points=total)


def _stage_and_folder(out: Path, colour: str) -> tuple[str, str]:
    """Return the stage and the folder of a colouring."""
    first = Manifest(out).settings("export-ply")
    if first is None or first.colour == colour:
        return "export-ply", "ply"
    return f"export-ply-{colour}", f"ply/{colour}"


def _export_maps(
    results: ResultFolder,
    chosen: ChosenResults,
    colour: str,
    scale: Scale | None,
    voxel: float,
    options: RunOptions,
) -> Outcome:
    """Write the map of every drive, and replace earlier maps."""
    colours = _point_colours(results, chosen, colour, scale)
    folder, outcome = OwnedFolder(results.root), Outcome(0, (), 0, chosen.missing)
    scans = results.with_column("label", chosen.scans)
    for name, group in groupby(scans, lambda file: file.sequence):
        files, path = tuple(group), results.root / "sequences" / name / "map.ply"
        folder.refuse_foreign([path])
        columns, added = _map_of_drive(results, files, colours.space, voxel, options)
        failures, done = outcome.failures + added.failures, outcome.done + added.done
        seconds = outcome.seconds + added.seconds
        outcome = replace(outcome, failures=failures, done=done, seconds=seconds)
        if columns:
            if colours.colour not in columns:
                raise results.missing_column(colours.colour, files[0])
            points = {axis: columns.pop(axis) for axis in "xyz"}
            folder.replace({path: _encode_cloud(points, columns, colours)})
            log.log(NOTICE, "%s: %s", path, counted(len(points["x"]), "point"))
            if (parts := len({*columns["part"].tolist()})) > 1:
                log.log(NOTICE, "%s: %d parts with unknown relative positions", path, parts)
    return outcome


def _map_of_drive(
    results: ResultFolder,
    files: tuple[ScanFile, ...],
    space: LabelSpace,
    voxel: float,
    options: RunOptions,
) -> tuple[Columns, Outcome]:
    """Merge the scans of a sequence; the map is empty if no scan can be read."""
    files = tuple(sorted(files, key=drive_order))
    drive = drive_of_map(results, files)
    clouds, origins = list[Columns](), drive.origins
    ways = drive.poses[:, :3, 3] - origins[drive.parts]
    require_near(ways, voxel, "--map-voxel", "make a map of larger voxels")

    def add(columns: Columns) -> None:
        clouds.append(columns)
        first, *waiting = (len(cloud["x"]) for cloud in clouds)
        if sum(waiting) > max(first, MERGED_POINTS):
            clouds[:] = [one_per_voxel(clouds, voxel, origins)]

    fused = results.settings("fuse")
    reach = ((fused.reach if fused else None) or FusionReach()).reach
    task = MapTask(results, files, drive, space, voxel, reach)
    outcome = run_over_scans(task, files, options, on_result=add)
    return one_per_voxel(clouds, voxel, origins) if clouds else {}, outcome
