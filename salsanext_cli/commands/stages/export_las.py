# SPDX-License-Identifier: MIT
"""Stage `export-las`: scans as LAS or LAZ clouds with their classification and every value."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.asprs import classes_without_code, names_of_codes
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Origin
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few, with_hint
from salsanext_cli.io.formats.survey.las_labels import LasLabels, labelled_las
from salsanext_cli.runs.annotation.map_frames import (
    digest_of_frames,
    frames_beside,
    refuse_ignored_frames,
    with_frame,
)
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import ExportLasSettings
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import scalar_columns
from salsanext_cli.runs.scans.scan_file import ScanFile

KEPT = ("intensity",)  # Values that a LAS file has already

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class LasExport:
    """Task that writes a scan as a LAS cloud with all scalars."""

    sensor: Sensor
    output: OutputRun
    space: LabelSpace  # Classes of the labels
    classes: LabelSpace | None  # Classes into which predicted ones are merged
    labels: LabelSpace  # Meaning of the raw ids of the truth
    compressed: bool
    frames: Mapping[ScanFile, Origin]  # Of points in map coordinates, metres, beside the scans

    def __call__(self, file: ScanFile) -> None:
        """Write the cloud of a scan."""
        self.output.require_replaceable(file)
        folder = ResultFolder(self.output.root)
        results = folder.read(file, self.sensor, self.classes, (self.labels, self.space))
        if results.label is None:
            raise folder.missing_column("label", file)
        values = scalar_columns(results, self.space)
        labels = LasLabels(
            codes=self.space.asprs_codes,
            names=names_of_codes(self.space),
            raw=results.label,
            values={name: column for name, column in values.items() if name not in KEPT},
        )
        scan = with_frame(file, results.scan, self.frames)
        content = labelled_las(file.path, scan, labels, compressed=self.compressed)
        self.output.write(self.output.path(file, self.output.folders[0]), content)


def export_las(
    out: Path,
    *,
    compressed: bool = False,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Outcome:
    """Write `OUT/sequences/<seq>/las/*.las`: the scan, its classification and every known scalar.

    A scan in LAS keeps its points, fields and records. The classification has the codes of the
    ASPRS that the label space states; the values become extra dimensions.

    Parameters
    ----------
    out : Path
        Folder with results.
    compressed : bool
        Whether to write `laz/*.laz` instead.
    query, options
        Choice of scans, data set and classes; workers and progress.

    Returns
    -------
    Outcome
    """
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    results.require_column("label", chosen.scans)
    _warn_about_codes(chosen.space)
    folder = "laz" if compressed else "las"
    stage = f"export-{folder}"
    settings = ExportLasSettings(
        label_space=chosen.space,
        origins=results.provenance.origins(PREDICTION_STAGES),
        frames=digest_of_frames(chosen.listed),
    )
    earlier = results.manifest.settings(stage)
    if isinstance(earlier, ExportLasSettings) and earlier.frames not in (None, settings.frames):
        refuse_ignored_frames(chosen.listed)
    is_outdated = isinstance(earlier, ExportLasSettings) and not earlier.is_of_inputs_of(settings)
    frames = frames_beside(chosen.scans)  # Read before outdated clouds are removed
    run = output_run(
        out,
        stage,
        settings,
        (folder,),
        chosen.scans,
        overwrite=options.overwrite or is_outdated,
        record_scans=False,
    )
    with run as output:
        task = LasExport(
            sensor=results.provenance.sensor(),
            output=output,
            space=chosen.space,
            classes=query.classes,
            labels=chosen.labels,
            compressed=compressed,
            frames=frames,
        )
        outcome = run_over_scans(task, chosen.scans, options, is_done=output.is_done, writes=[out])
    log.log(NOTICE, "classified: %s", out / "sequences/*" / folder)
    return replace(outcome, missing=chosen.missing)


def _warn_about_codes(space: LabelSpace) -> None:
    """Warn about classes whose points become unassigned."""
    names = classes_without_code(space)
    if names:
        problem = f"label space {space.name} has no code of the ASPRS for {first_few(names)}"
        hint = "state the codes of their raw ids in its yaml file, as `asprs: {10: 64}`"
        log.warning("%s", with_hint(f"{problem}: their points are written as unassigned", hint))
