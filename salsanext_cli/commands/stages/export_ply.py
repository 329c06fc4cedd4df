# SPDX-License-Identifier: MIT
"""Stage `export-ply`: scans as coloured PLY point clouds."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats.field_names import PREFIX
from salsanext_cli.io.formats.ply import encode_ply
from salsanext_cli.report.colours import PointColours, common_scales, require_colouring
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.records.stage_settings import ExportSettings
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.results.output_run import OutputRun, output_run
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ChosenResults, ResultFolder
from salsanext_cli.runs.results.scan_results import scalar_columns
from salsanext_cli.runs.scans.scan_file import ScanFile

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Destination:
    """Stage and folder of the clouds of a colouring."""

    stage: str
    folder: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudExport:
    """Task that writes a scan as a coloured cloud with all scalars."""

    colours: PointColours
    sensor: Sensor
    output: OutputRun
    classes: LabelSpace | None  # Classes into which predicted ones are merged
    labels: LabelSpace  # Meaning of the raw ids of the truth

    def __call__(self, file: ScanFile) -> None:
        """Write the cloud of a scan."""
        self.output.require_replaceable(file)
        folder = ResultFolder(self.output.root)
        space = self.colours.space
        results = folder.read(file, self.sensor, self.classes, (self.labels, space))
        columns = scalar_columns(results, space)
        colour = self.colours.colour
        if colour not in columns:
            raise folder.missing_column(colour, file)
        points = dict(zip("xyz", results.scan.points.T, strict=True))
        rgb = dict(zip(("red", "green", "blue"), self.colours.rgb(columns).T, strict=True))
        # CloudCompare takes properties with this prefix for scalars, and shows the first.
        scalars = {f"{PREFIX}{colour}": columns[colour]}
        scalars |= {f"{PREFIX}{name}": values for name, values in columns.items()}
        comments = [f"colour {self.colours.legend}", f"label space {space.name}"]
        accepted = results.accepted_text(space)
        if accepted:
            comments.append(accepted)
        content = encode_ply(points | rgb | scalars, comments)
        self.output.write(self.output.path(file, self.output.folders[0]), content)


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
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures and of existing results.

    Returns
    -------
    Outcome
    """
    require_colouring([colour], scale)
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    if colour == "uncertainty":
        colour = results.default_uncertainty(chosen.scans)
    results.require_column(colour, chosen.scans)
    destination = _destination(results, colour)
    origins = results.provenance.origins(PREDICTION_STAGES)
    earlier = _recorded(results, destination.stage)
    is_outdated = earlier is not None and earlier.origins != origins
    overwrite = options.overwrite or is_outdated
    continued = None if overwrite else earlier
    ends = _ends_of_scale(results, chosen, colour, scale, continued)
    settings = ExportSettings(colour=colour, scale=ends, label_space=chosen.space, origins=origins)
    run = output_run(
        out,
        destination.stage,
        settings,
        (destination.folder,),
        chosen.scans,
        overwrite=overwrite,
        record_scans=False,
    )
    with run as output:
        task = CloudExport(
            colours=PointColours(colour=colour, scale=ends, space=chosen.space),
            sensor=results.provenance.sensor(),
            output=output,
            classes=query.classes,
            labels=chosen.labels,
        )
        outcome = run_over_scans(task, chosen.scans, options, is_done=output.is_done, writes=[out])
    log.log(NOTICE, "coloured by %s: %s", colour, out / "sequences/*" / destination.folder)
    return replace(outcome, missing=chosen.missing)


def _ends_of_scale(
    results: ResultFolder,
    chosen: ChosenResults,
    colour: str,
    scale: tuple[float, float] | None,
    continued: ExportSettings | None,
) -> tuple[float, ...]:
    """Return the ends of the colour map: as asked for, as in the continued run, or common ones."""
    if scale is not None:
        return scale
    if continued is not None and continued.scale is not None:
        return continued.scale
    sensor = results.provenance.sensor()
    scales = common_scales(results.root, chosen.scans, [colour], chosen.space, sensor)
    return scales.get(colour, (0.0, 1.0))


def _destination(results: ResultFolder, colour: str) -> Destination:
    """Return where the clouds of a colouring go: beside those in another colour, which stay."""
    first = _recorded(results, "export-ply")
    if first is None or first.colour == colour:
        return Destination(stage="export-ply", folder="ply")
    return Destination(stage=f"export-ply-{colour}", folder=f"ply/{colour}")


def _recorded(results: ResultFolder, stage: str) -> ExportSettings | None:
    """Return the settings of an earlier export, None if it did not run."""
    settings = results.manifest.settings(stage)
    return settings if isinstance(settings, ExportSettings) else None
