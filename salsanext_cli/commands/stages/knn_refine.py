# SPDX-License-Identifier: MIT
"""Stage `knn-refine`: labels of pixels, assigned to points by neighbours."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.commands.jobs.plans.prepared_run import PreparedRun
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.errors import LabelError, NoInputError, OutputError, UsageError
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.records import RangeImage
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.npy import read_array
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import RefineSettings
from salsanext_cli.runs.results.output_paths import with_outputs
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, space_of
from salsanext_cli.runs.summary.recorded_summary import recorded_summary
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledPixels:
    """Scan with the labels of its pixels."""

    file: ScanFile
    image: RangeImage
    labels: TrainIds  # (H, W)


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineJob:
    """Job that refines pixel labels by neighbours."""

    space: LabelSpace
    sensor: Sensor
    knn: KnnParameters
    output: OutputRun

    def prepare(self, file: ScanFile) -> LabelledPixels:
        """Read and project a scan, and read the labels of its pixels."""
        self.output.require_replaceable(file)
        scan = read_scan(file.path, self.sensor)
        image = project(scan, sensor_of_result(self.output.root, file, scan, self.sensor))
        path = self.output.path(file, "pixel_labels")
        labels: TrainIds = read_array(path, "uint8", (self.sensor.height, self.sensor.width))
        highest = labels.max()
        if highest >= self.space.class_count:
            expected = f"0 to {self.space.class_count - 1}, the classes of {self.space.name}"
            raise LabelError(path, f"has train ids up to {highest}", expected)
        return LabelledPixels(file=file, image=image, labels=labels)

    def compute(self, scans: Sequence[LabelledPixels]) -> list[TrainIds]:
        """Return the labels of the points of each scan, (N,) uint8."""
        count = self.space.class_count
        return [knn_refine(scan.image, scan.labels, count, self.knn) for scan in scans]

    def finish(self, scan: LabelledPixels, refined: TrainIds) -> ScanSummary:
        """Write the labels of the points."""
        self.output.write_labels(scan.file, self.space.to_raw(refined))
        return ScanSummary.from_labels(scan.file, refined, self.space)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRefinement(PreparedRun):
    """Refinement before its first scan."""

    sensor: Sensor  # Of the range images
    space: LabelSpace


def knn_refine_scans(
    out: Path,
    *,
    dataset: Path | None = None,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    knn: KnnParameters = KnnParameters(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Refine labels of pixels into `OUT/sequences/<seq>/predictions`.

    Parameters
    ----------
    out : Path
        Output folder, with the labels of pixels.
    dataset : Path, optional
        Scans; by default those of `out`.
    sensor : Sensor, optional
        Sensor of the range images; by default as recorded in `out`.
    space : LabelSpace, optional
        Label space; by default as recorded in `out`.
    knn : KnnParameters
        Neighbourhood.
    selection : ScanSelection, optional
        Choice of the scans; all by default.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    Outcome
    """
    prepared = _prepared(
        out,
        dataset=dataset,
        sensor=sensor,
        space=space,
        knn=knn,
        selection=selection,
        overwrite=options.overwrite,
    )
    scans = prepared.scans
    summary = RunSummary(sensor=prepared.sensor, space=prepared.space, scans=scans)
    with prepared.opened() as output, recorded_summary(summary, output, scans):
        job = RefineJob(space=prepared.space, sensor=prepared.sensor, knn=knn, output=output)
        return run_over_scans(
            job, scans, options, is_done=output.is_done, summary=summary, writes=[out]
        )


def plan_refinement(
    out: Path,
    *,
    dataset: Path | None = None,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    knn: KnnParameters = KnnParameters(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> RunPlan:
    """Return what `knn_refine_scans` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    out, dataset, sensor, space, knn, selection, options
        As for `knn_refine_scans`.

    Returns
    -------
    RunPlan

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    prepared = _prepared(
        out,
        dataset=dataset,
        sensor=sensor,
        space=space,
        knn=knn,
        selection=selection,
        overwrite=options.overwrite,
    )
    run = prepared.foreseen()
    plan = RunPlan.from_scans(prepared.listed, prepared.scans, options.shard, run.is_done)
    return plan.with_results(prepared.scans, prepared.folders, prepared.sensor)


def _prepared(
    out: Path,
    *,
    dataset: Path | None,
    sensor: Sensor | None,
    space: LabelSpace | None,
    knn: KnnParameters,
    selection: ScanSelection,
    overwrite: bool,
) -> PreparedRefinement:
    """Find the scans with labels of pixels; arguments as of `knn_refine_scans`."""
    results = ResultFolder(out)
    _require_unrejected(results)
    scans = find_scans(dataset) if dataset else results.scans()
    space = _space_of_pixels(results, space) or space_of(scans)
    with_labels = with_outputs(scans, out, "pixel_labels")
    if not with_labels:
        raise _no_pixel_labels(out)
    chosen = choose(with_labels, selection, space_of(with_labels, space), out)
    sensor = sensor or results.provenance.sensor()
    settings = RefineSettings(
        label_space=space, sensor=sensor, knn=knn, origins=results.provenance.origins(["predict"])
    )
    return PreparedRefinement(
        out=out,
        stage="knn-refine",
        listed=with_labels,
        scans=chosen,
        recorded=settings,
        folders=("predictions",),
        overwrite=overwrite,
        records_scans=dataset is not None,
        sensor=sensor,
        space=space,
    )


def _require_unrejected(results: ResultFolder) -> None:
    """Refuse labels of which some were rejected."""
    if results.provenance.rejected_above("pixel_labels") is not None:
        problem = "has labels of which some were rejected"
        expected = "all labels, since the vote restores rejected ones"
        raise OutputError(results.root, problem, expected, f"predict without {argument('reject')}")


def _space_of_pixels(results: ResultFolder, space: LabelSpace | None) -> LabelSpace | None:
    """Return the label space of the labels of pixels: as asked for, as recorded, else None."""
    recorded = results.provenance.label_space("pixel_labels")
    if recorded and space and not recorded.fits(space):
        problem = f"{space.name}, but the pixel labels have the classes of {recorded.name}"
        hint = f"predict with {argument('classes')}, or omit it"
        raise UsageError(argument("space"), problem, hint=hint)
    return space or recorded or results.provenance.label_space()


def _no_pixel_labels(out: Path) -> NoInputError:
    """Return the error of a folder without labels of pixels, with the command that writes them."""
    predict = command(f"salsanext predict SCANS {out}", setting("extras", ("pixel_labels",)))
    return NoInputError(out, "has no pixel labels", hint=f"run `{predict}` first")
