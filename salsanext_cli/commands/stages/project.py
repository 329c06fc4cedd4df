# SPDX-License-Identifier: MIT
"""Stage `project`: scans to range images on disk."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from salsanext_cli.commands.jobs.plans.prepared_run import PreparedRun
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.core.labelling import ProjectedScan, project_scan
from salsanext_cli.core.records import Origins
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.fit.scan_reading import read_measured
from salsanext_cli.runs.fit.sensor_fit import fitted_members
from salsanext_cli.runs.loop.recorded_names import with_recorded_names
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_origins import OriginsOfRun
from salsanext_cli.runs.records.stage_settings import ProjectSettings
from salsanext_cli.runs.results.folder_names import ORIGINS
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import (
    folders_of_origins,
    origin_array,
    origin_in_run,
)
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, scans_of, space_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary

FOLDERS = ("range", "pixels")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProjectedFile:
    """File of a scan, and its projected scan."""

    file: ScanFile
    scan: ProjectedScan


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectJob:
    """Job that projects scans and writes their range images, without a step on a device."""

    sensor: Sensor
    output: OutputRun
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> ProjectedFile:
        """Read, check and project a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.sensor, self.origins)
        scan = read_measured(file.path, self.sensor)
        projected = project_scan(scan, self.sensor, origin=origin, source=file.path)
        return ProjectedFile(file=file, scan=projected)

    def compute(self, scans: Sequence[ProjectedFile]) -> Sequence[None]:
        """Return nothing for each scan."""
        return [None] * len(scans)

    def finish(self, projected: ProjectedFile, _: None) -> ScanSummary:
        """Write the range image and the pixels of the points."""
        file = projected.file
        scan = projected.scan
        if ORIGINS in self.output.folders:
            self.output.write_array(file, ORIGINS, origin_array(scan.origin))
        self.output.write_array(file, "range", scan.image.channels)
        self.output.write_array(file, "pixels", scan.image.pixel_of_point)
        return ScanSummary(file=file, check=scan.check)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedProjection(PreparedRun):
    """Projection before its first scan."""

    sensor: Sensor  # Fitted to the scans


def project_scans(
    source: Path | Sequence[Path],
    out: Path,
    *,
    sensor: Sensor,
    fit: bool = False,
    fit_mounting: bool = True,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Project scans to `OUT/sequences/<seq>/range` and `pixels`.

    Parameters
    ----------
    source : Path or sequence of Path
        Scans.
    out : Path
        Output folder.
    sensor : Sensor
        Sensor of the range images.
    fit : bool
        Whether to fit the field of view and the mounting to the scans.
    fit_mounting : bool
        Whether to fit the mounting with the field of view; else that of the sensor stays.
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
        sensor=sensor,
        fit=fit,
        fit_mounting=fit_mounting,
        selection=selection,
        overwrite=options.overwrite,
    )
    listed = prepared.listed
    scans = prepared.scans
    sensor = prepared.sensor
    summary = RunSummary(sensor=sensor, scans=scans)
    with prepared.opened() as output, recorded_summary(summary, output, scans):
        origins = OriginsOfRun(out=out, stage="project", listed=listed, overwrite=options.overwrite)
        job = ProjectJob(
            sensor=sensor, output=output, origins=origins.result_origins(output, scans, sensor)
        )
        return run_over_scans(
            job, scans, options, is_done=output.is_done, summary=summary, writes=[out]
        )


def plan_projection(
    source: Path | Sequence[Path],
    out: Path,
    *,
    sensor: Sensor,
    fit: bool = False,
    fit_mounting: bool = True,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `project_scans` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    source, out, sensor, fit, fit_mounting, selection, options
        As for `project_scans`.

    Returns
    -------
    RunPlan

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    prepared = _prepared(
        source,
        out,
        sensor=sensor,
        fit=fit,
        fit_mounting=fit_mounting,
        selection=selection,
        overwrite=options.overwrite,
    )
    run = prepared.foreseen()
    plan = RunPlan.from_scans(prepared.listed, prepared.scans, options.shard, run.is_done)
    return plan.with_results(prepared.scans, prepared.folders, prepared.sensor)


def _prepared(
    source: Path | Sequence[Path],
    out: Path,
    *,
    sensor: Sensor,
    fit: bool,
    fit_mounting: bool,
    selection: ScanSelection,
    overwrite: bool,
) -> PreparedProjection:
    """Find the scans, and fit the sensor to them; arguments as of `project_scans`."""
    listed = with_recorded_names(scans_of(source), out)
    scans = choose(listed, selection, space_of(listed), source)
    recorded = None if overwrite else Manifest(out).settings("project")
    earlier = recorded.sensor if recorded else None
    sensor = fitted_members(listed, sensor, earlier, view=fit, mounting=fit_mounting)
    return PreparedProjection(
        out=out,
        stage="project",
        listed=listed,
        scans=scans,
        recorded=ProjectSettings(sensor=sensor),
        folders=(*FOLDERS, *folders_of_origins(out, "project", sensor)),
        overwrite=overwrite,
        sensor=sensor,
    )
