# SPDX-License-Identifier: MIT
"""Stage `knn-refine`: labels of pixels, or any labels of points, refined by neighbours."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.errors import LabelError, NoInputError, OutputError, UsageError, counted
from salsanext_cli.files.reading import present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.npy import read_array
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import pixels_from_points, project
from salsanext_cli.geometry.scan_traits import sensor_of
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.option_fields import KnnParameters, ScanSelection
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import RangeImage
from salsanext_cli.results.manifest import Manifest, StageSettings
from salsanext_cli.results.output_run import OutputRun, output_run
from salsanext_cli.results.paths import ScanFile, find_scans, output_path, with_outputs
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import choose, space_of
from salsanext_cli.sensors.sensor import Sensor


class LabelledPixels(NamedTuple):
    """Scan with the labels of its pixels."""

    file: ScanFile
    image: RangeImage
    labels: TrainIds  # (H, W)


@dataclass(frozen=True, slots=True)
class RefineJob:
    """Job that refines pixel labels, or a folder of point labels, by neighbours."""

    labels: Path | None  # Folder of point labels, None for pixel labels
    space: LabelSpace
    sensor: Sensor
    knn: KnnParameters
    output: OutputRun

    def prepare(self, file: ScanFile) -> LabelledPixels:
        """Read a scan and its labels, and project both."""
        self.output.require_replaceable(file)
        scan, space = read_scan(file.path, self.sensor), self.space
        image = project(scan, sensor_of(scan, self.sensor))
        if self.labels is not None:
            path = _given_labels(self.labels, file)
            train_ids = space.to_train(read_labels(path, len(scan)), source=path)
            return LabelledPixels(file, image, pixels_from_points(train_ids, image.point_of_pixel))
        path = self.output.path(file, "pixel_labels")
        labels: TrainIds = read_array(path, "uint8", (self.sensor.height, self.sensor.width))
        if (highest := labels.max()) >= space.class_count:
            expected = f"0 to {space.class_count - 1}, the classes of {space.name}"
            raise LabelError(path, f"has train ids up to {highest}", expected)
        return LabelledPixels(file, image, labels)

    def compute(self, scans: Sequence[LabelledPixels]) -> list[TrainIds]:
        """Return the labels of the points of each scan, (N,) uint8."""
        count = self.space.class_count
        return [knn_refine(scan.image, scan.labels, count, self.knn) for scan in scans]

    def finish(self, scan: LabelledPixels, refined: TrainIds) -> ScanSummary:
        """Write the labels of the points."""
        self.output.write_labels(scan.file, self.space.to_raw(refined))
        return ScanSummary.of_labels(scan.file, refined, self.space)


def _given_labels(folder: Path, file: ScanFile) -> Path:
    """Return the label file of a scan in an output folder, or else in a plain folder of labels."""
    nested = output_path(folder, file.sequence, "predictions", file.stem)
    return nested if present(nested) else folder / nested.name


def _require_all_labels(out: Path, labels: Path | None) -> None:
    """Refuse results of a run that rejected labels, since the vote would restore them."""
    folder = "predictions" if labels else "pixel_labels"
    # Labels may lie in ROOT/sequences/<seq>/predictions, with the records in ROOT.
    roots = (labels, *labels.absolute().parents[2:3]) if labels else (out,)
    if any(Manifest(root).rejection(folder) for root in roots):
        problem, hint = "has labels of which some were rejected", "predict without --reject"
        expected = "all labels, since the vote restores rejected ones"
        raise OutputError(labels or out, problem, expected, hint)


def knn_refine_scans(
    out: Path,
    *,
    labels: Path | None = None,
    dataset: Path | None = None,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    knn: KnnParameters = KnnParameters(),
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Refine labels of pixels or points into `OUT/sequences/<seq>/predictions`.

    Parameters
    ----------
    out : Path
        Output folder, with the labels of pixels unless `labels` is given.
    labels : Path, optional
        Folder of labels of points.
    dataset : Path, optional
        Scans; by default those of `out`.
    sensor, space : optional
        Sensor of the range images and label space; by default as recorded in `out`.
    knn : KnnParameters
        Neighbourhood.
    selection : ScanSelection
        Scans to refine.
    options : RunOptions
        Workers, and what to do with existing results and errors.

    Returns
    -------
    Outcome
        Numbers of the run.
    """
    _require_all_labels(out, labels)
    results, scans, space = _scans_to_refine(out, labels, dataset, space, selection)
    sensor = sensor or results.sensor()
    settings = StageSettings(
        labels=str(labels.absolute()) if labels else None,
        label_space=space,
        sensor=sensor,
        knn=knn,
        origins=None if labels else results.origins(["predict"]),
    )
    summary = RunSummary(sensor, space, scans)
    wanted, overwrite = (out, "knn-refine", settings, ("predictions",), scans), options.overwrite
    run = output_run(*wanted, overwrite=overwrite, record_scans=dataset is not None)
    with run as output, summary.recorded_in(output, scans):
        job = RefineJob(labels, space, sensor, knn, output)
        return run_over_scans(job, scans, options, is_done=output.is_done, summary=summary)


def _scans_to_refine(
    out: Path,
    labels: Path | None,
    dataset: Path | None,
    space: LabelSpace | None,
    selection: ScanSelection,
) -> tuple[ResultFolder, list[ScanFile], LabelSpace]:
    """Return the results, the selected scans with labels, and their label space."""
    results = ResultFolder(out)
    if labels and labels.resolve().is_relative_to(out.resolve()):
        raise UsageError("--labels", f"{labels} is inside {out}", "a folder outside the output")
    scans = find_scans(dataset) if dataset else results.scans()
    recorded = results.label_space("pixel_labels") if labels is None else None
    if recorded and space and not recorded.fits(space):
        problem = f"{space.name}, but the pixel labels have the classes of {recorded.name}"
        raise UsageError("--label-space", problem, hint="predict with --classes, or leave it out")
    space = space or recorded or results.label_space() or space_of(scans)
    if labels is None:
        scans = with_outputs(scans, out, "pixel_labels")
        if not scans:
            hint = f"run `salsanext predict SCANS {out} --pixel-labels` first, or use --labels"
            raise NoInputError(out, "has no pixel labels", hint=hint)
    scans = choose(scans, selection, space_of(scans, space), out)
    if labels is not None and not any(present(_given_labels(labels, scan)) for scan in scans):
        nested = output_path(Path(), scans[0].sequence, "predictions", scans[0].stem)
        problem = f"has labels of none of {counted(len(scans), 'scan')}"
        problem = problem if present(labels) else "no such folder"
        raise NoInputError(labels, problem, f"files like {nested} or {nested.name}")
    return results, scans, space
